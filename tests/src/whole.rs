//! Renders and training steps of Gaussians that a test creates.

use crate::{Gpu, scenes};
use sgs_config::Settings;
use sgs_engine::Location;
use sgs_passes::Tuning;
use sgs_passes::loss::octahedral_encode;
use sgs_passes::pipeline::{GeometryOptions, GeometryStep, Inputs, Renderer, Status, StepReport};
use sgs_passes::reference::project::{Camera, Gaussians as ReferenceGaussians};
use sgs_passes::scene::{GaussianData, Gaussians, Model};
use sgs_passes::splat::{BackwardKernel, Channels};
use sgs_train::Schedule;

/// Background color, linear RGB.
pub const BACKGROUND: [f64; 3] = [0.2, 0.5, 0.8];

/// Returns the highest spherical harmonics band of the Gaussians.
pub fn degree(g: &ReferenceGaussians) -> u32 {
    (0..4).rev().find(|b| !g.sh[*b].is_empty()).unwrap_or(0) as u32
}

fn upload(gpu: &Gpu, g: &ReferenceGaussians, training: bool) -> sgs_engine::Result<Gaussians> {
    let model = Model { sh_degree: degree(g), normals: !g.normals.is_empty(), semantics: false, mip: g.mip };
    let gaussians = Gaussians::new(gpu.device(), model, (g.len() as u32).max(1), training)?;
    gaussians.upload(gpu.device(), &scenes::data(g))?;
    Ok(gaussians)
}

/// Returns the channels: colors, normals if the Gaussians have any, and depth if requested.
fn channels(g: &ReferenceGaussians, depth: bool) -> Channels {
    Channels { colors: true, normals: !g.normals.is_empty(), depth }
}

/// Renders colors and transmittance of one view.
///
/// # Errors
/// Errors of the engine.
pub fn rendered(gpu: &Gpu, g: &ReferenceGaussians, camera: &Camera) -> sgs_engine::Result<(Vec<f32>, Vec<f32>)> {
    channels_of(gpu, g, camera, false)
}

/// Returns the tuning for a camera, which may have distortion.
fn tuning(gpu: &Gpu, camera: &Camera) -> Tuning {
    Tuning { distorted: camera.radial != 0.0, ..gpu.tuning() }
}

/// Renders one view: colors, normals if present, depth if requested, and transmittance.
///
/// Depth comes with its square.
///
/// # Errors
/// Errors of the engine.
pub fn channels_of(
    gpu: &Gpu,
    g: &ReferenceGaussians,
    camera: &Camera,
    depth: bool,
) -> sgs_engine::Result<(Vec<f32>, Vec<f32>)> {
    let gaussians = upload(gpu, g, false)?;
    let mut renderer = Renderer::new(gpu.device(), tuning(gpu, camera), &gaussians, camera.size, channels(g, depth))?;
    let background = BACKGROUND.map(|b| b as f32);
    let rendered = renderer.render(&gaussians, &scenes::gpu_camera(camera), degree(g), background)?;
    Ok((rendered.image, rendered.transmittance))
}

/// Trains some steps toward a gray photograph, in one view.
///
/// Returns the report of each step and the final parameters.
///
/// # Errors
/// Errors of the engine.
pub fn steps(
    gpu: &Gpu,
    g: &ReferenceGaussians,
    camera: &Camera,
    count: u32,
) -> sgs_engine::Result<(Vec<StepReport>, GaussianData)> {
    steps_of(gpu, g, camera, false, count)
}

/// Returns options of a training step that gathers no statistics.
pub fn step_options(largest: [u32; 2], channels: Channels) -> GeometryOptions {
    GeometryOptions {
        largest,
        entry_capacity: 1 << 14,
        channels,
        statistics: None,
        mcmc: false,
        dense_adam: false,
        backward: BackwardKernel::Pixel,
        semantic_geometry: false,
        pseudo: None,
        timestamps: false,
        frames_in_flight: 1,
    }
}

/// Trains like [`steps`], with the losses of normals and depth.
///
/// The loss of normals needs Gaussians with normals and uses a constant prior. The loss of depth is on if requested.
///
/// # Errors
/// Errors of the engine.
pub fn steps_of(
    gpu: &Gpu,
    g: &ReferenceGaussians,
    camera: &Camera,
    depth: bool,
    count: u32,
) -> sgs_engine::Result<(Vec<StepReport>, GaussianData)> {
    let device = gpu.device();
    let gaussians = upload(gpu, g, true)?;
    let pixels = camera.size[0] as usize * camera.size[1] as usize;
    let targets = device.buffer("targets", 4 * pixels as u64, Location::Device)?;
    device.upload(&targets, 0, bytemuck::cast_slice(&vec![0xff80_8080_u32; pixels]))?;
    let priors = device.buffer("priors", 4 * pixels as u64, Location::Device)?;
    device.upload(&priors, 0, bytemuck::cast_slice(&vec![octahedral_encode([0.6, -0.2, -0.7]); pixels]))?;
    let normals = (!g.normals.is_empty()).then_some(&priors);
    let inputs = Inputs { normals, ..Inputs::of(&targets) };
    let mut options = step_options(camera.size, channels(g, depth));
    let schedule = Schedule::new(&Settings::default(), 1.0, 1);
    let (tuning, camera) = (tuning(gpu, camera), scenes::gpu_camera(camera));
    let status = Status::new(device)?;
    let mut exec = GeometryStep::new(device, &tuning, &gaussians, &inputs, &status, options)?;
    let mut reports = Vec::new();
    while (reports.len() as u32) < count {
        let step = reports.len() as u32 + 1;
        exec.submit(&schedule.step(step, &camera, 0))?;
        exec.finish()?;
        let report = status.report(step)?;
        if report.flags != 0 {
            // Like the trainer: raise the capacity to the requested number and repeat the step.
            assert!(report.entries > options.entry_capacity, "a flag without reason: {report:?}");
            options.entry_capacity = report.entries;
            exec = GeometryStep::new(device, &tuning, &gaussians, &inputs, &status, options)?;
            status.clear_flags(device)?;
            continue;
        }
        reports.push(report);
    }
    Ok((reports, gaussians.download(device)?))
}

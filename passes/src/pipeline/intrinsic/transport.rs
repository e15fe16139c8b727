//! Physical lights and bounced light of an intrinsic step, and their gradients.
//!
//! Forward: surfels take their materials from Gaussians; the radiosity of all receivers is solved; its irradiance reaches the
//! Gaussians and, blended, the pixels. Backward: the adjoint of each of these, in reverse order. Rays are fixed.

use super::build::Frame;
use super::{IntrinsicOptions, Steps};
use crate::Tuning;
use crate::optim::Rate;
use crate::pipeline::transport::{TransportHandles, TransportShape};
use crate::scene::TrainableHandles;
use crate::shade::{PixelMaterials, Pixels, RawMaterials, Weights, materials, materials_bwd};
use crate::splat::Screen;
use crate::transport::{
    AdjointInputs, AreaLights, BlendGradients, GatherInputs, ParameterGradients, ShadeGradients, Solution,
    SolveGradients, SolveInputs, SolveOptions, SourceGradients, SourceInputs, Sources, TransportShading,
    irradiance_blend_bwd, irradiance_gather, irradiance_gather_bwd, transport_adjoint, transport_shade,
    transport_shade_bwd, transport_solve, transport_source, transport_source_bwd,
};
use sgs_engine::graph::{Buffer, Graph, GraphError};

/// Physical lights and bounced light of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransportTraining {
    /// Sizes of the room.
    pub shape: TransportShape,
    /// Weight of the loss that pulls gains towards 1. Without it gains are not trained.
    pub gain_pull: Option<f32>,
    /// Learning rate of the log gains; multiplied by `lr_share` of the step.
    pub gains_rate: f32,
    /// Learning rate of log colors and of the raw albedo of the enclosure.
    pub rate: f32,
}

/// Handles of the transport of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Declared {
    pub memory: TransportHandles,
    /// Irradiance of the view's pixels from each light of color 1.
    pub unit: Buffer,
    pub log_colors: TrainableHandles,
    pub enclosure: TrainableHandles,
    pub log_gains: TrainableHandles,
}

/// Results of the forward passes that the backward passes need.
pub(super) struct Bounced {
    pub radiance: Buffer,
    shading: TransportShading,
    source: SourceInputs,
    reflectance: Buffer,
    irradiance: Buffer,
    weights: Weights,
}

/// Gradients of raw materials, of Gaussians.
pub(super) struct Into<'a> {
    pub raw: &'a RawMaterials,
    pub gradients: &'a RawMaterials,
}

/// Returns the screen whose pixels are the surfels.
fn surfel_screen(t: &Tuning, steps: &Steps, shape: &TransportShape) -> Screen {
    Screen { step: steps.surfels, largest: [shape.surfels, 1], tile: t.tile }
}

/// Adds the forward passes.
pub(super) fn forward(
    g: &mut Graph,
    f: &Frame<'_>,
    d: &Declared,
    pixels: &Pixels,
    of_gaussians: &PixelMaterials,
    weights: &Weights,
    o: &TransportTraining,
) -> Result<Bounced, GraphError> {
    let (t, shape) = (f.t, &o.shape);
    let (receivers, lights) = (shape.matrix.receivers, shape.lights);
    let has_metallic = of_gaussians.metallic.is_some();
    let surfels = PixelMaterials {
        materials: g.transient("surfel_materials", 16 * u64::from(shape.surfels)),
        metallic: has_metallic.then(|| g.transient("surfel_metallic", 4 * u64::from(shape.surfels))),
    };
    let weights_of_surfels = d.memory.surfel_weights();
    materials(g, t, &surfel_screen(t, f.steps, shape), of_gaussians, &weights_of_surfels, &surfels)?;
    let source = SourceInputs {
        receivers,
        surfels: shape.surfels,
        lights,
        materials: surfels,
        enclosure: d.enclosure.parameters,
        faces: d.memory.faces(),
        unit: d.memory.unit(),
        log_colors: d.log_colors.parameters,
    };
    let three = 12 * u64::from(receivers);
    let sources = Sources {
        reflectance: g.transient("reflectance", three),
        source: g.transient("radiosity_source", three),
        colors: g.transient("light_colors", 12 * u64::from(lights.max(1))),
    };
    transport_source(g, t, &source, &sources)?;
    let solve = SolveInputs {
        matrix: d.memory.rows(shape.matrix),
        lights: 1,
        reflectance: sources.reflectance,
        source: sources.source,
        initial: None,
    };
    let solution = Solution {
        radiosity: g.transient("radiosity", three),
        irradiance: g.transient("receiver_irradiance", three),
        convergence: g.transient("convergence", 8),
    };
    transport_solve(g, t, &solve, &SolveOptions::default(), &solution)?;
    let values = g.transient("gaussian_irradiance", 16 * u64::from(shape.gaussians.max(1)));
    let [neighbors, neighbor_weights] = d.memory.neighbors();
    let gather = GatherInputs {
        gaussians: shape.gaussians,
        receivers,
        lights: 1,
        neighbors,
        weights: neighbor_weights,
        irradiance: solution.irradiance,
        log_gains: Some(d.log_gains.parameters),
    };
    irradiance_gather(g, t, &gather, values)?;
    let count = f.screen.pixels();
    let blended = |g: &mut Graph, name: &str, values: Buffer| {
        let into = g.transient(name, 16 * count);
        let plain = |buffer| PixelMaterials { materials: buffer, metallic: None };
        materials(g, t, &f.screen, &plain(values), weights, &plain(into)).map(|()| into)
    };
    let irradiance = blended(g, "pixel_irradiance", values)?;
    let emission = blended(g, "pixel_emission", d.memory.emission())?;
    let shading = TransportShading {
        pixels: *pixels,
        lights: AreaLights { records: d.memory.light_records(), colors: sources.colors, count: lights },
        unit: d.unit,
        irradiance,
        reflections: false,
        emission: Some(emission),
        split_sum: d.memory.split_sum(),
    };
    let radiance = g.transient("transport_radiance", 12 * count);
    transport_shade(g, *t, &shading, radiance, None)?;
    Ok(Bounced {
        radiance,
        shading,
        source,
        reflectance: sources.reflectance,
        irradiance: solution.irradiance,
        weights: *weights,
    })
}

/// Adds the passes from the gradient of the pixels' radiance to their materials.
///
/// Returns the gradients of irradiance and of colors.
pub(super) fn pixels_backward(
    g: &mut Graph,
    f: &Frame<'_>,
    b: &Bounced,
    radiance_gradient: Buffer,
    pixels: &PixelMaterials,
) -> Result<[Buffer; 2], GraphError> {
    let irradiance = g.transient("pixel_irradiance_gradient", 16 * f.screen.pixels());
    let colors = g.transient("colors_gradient", 12 * u64::from(b.source.lights.max(1)));
    let into =
        ShadeGradients { materials: pixels.materials, metallic: pixels.metallic, irradiance, emission: None, colors };
    transport_shade_bwd(g, *f.t, &b.shading, radiance_gradient, &into)?;
    Ok([irradiance, colors])
}

/// Adds the other backward passes. Adds to the gradients of raw materials. Returns the parameters to update.
pub(super) fn backward(
    g: &mut Graph,
    f: &Frame<'_>,
    d: &Declared,
    b: &Bounced,
    [irradiance, colors]: [Buffer; 2],
    into: &Into<'_>,
    o: &TransportTraining,
) -> Result<Vec<(TrainableHandles, Buffer, Rate)>, GraphError> {
    let (t, shape) = (f.t, &o.shape);
    let (receivers, n) = (shape.matrix.receivers, shape.gaussians);
    let values = g.transient("gaussian_irradiance_gradient", 16 * u64::from(n.max(1)));
    let log_gains = d.log_gains.gradient(g);
    let blend = BlendGradients {
        step: f.steps.shaded,
        gaussians: n,
        weights: &b.weights,
        pixels: irradiance,
        log_gains: d.log_gains.parameters,
        pull: o.gain_pull.unwrap_or(0.0),
    };
    irradiance_blend_bwd(g, t, &blend, values, log_gains)?;
    let three = 12 * u64::from(receivers);
    let by_irradiance = g.transient("receiver_irradiance_gradient", three);
    irradiance_gather_bwd(g, t, &d.memory.gather(receivers), values, by_irradiance)?;
    let adjoint = AdjointInputs {
        matrix: d.memory.columns(shape.matrix),
        lights: 1,
        reflectance: b.reflectance,
        irradiance: b.irradiance,
        radiosity_gradient: None,
        irradiance_gradient: Some(by_irradiance),
    };
    let solved = SolveGradients {
        source: g.transient("source_gradient", three),
        reflectance: g.transient("reflectance_gradient", three),
        convergence: g.transient("adjoint_convergence", 8),
    };
    transport_adjoint(g, t, &adjoint, &SolveOptions::default(), &solved)?;
    let gradients = SourceGradients { reflectance: solved.reflectance, source: solved.source, colors };
    let surfels = PixelMaterials {
        materials: g.transient("surfel_materials_gradient", 16 * u64::from(shape.surfels)),
        metallic: b
            .source
            .materials
            .metallic
            .map(|_| g.transient("surfel_metallic_gradient", 4 * u64::from(shape.surfels))),
    };
    let parameters = ParameterGradients {
        materials: surfels,
        log_colors: d.log_colors.gradient(g),
        enclosure: d.enclosure.gradient(g),
    };
    transport_source_bwd(g, t, &b.source, &gradients, &parameters)?;
    materials_bwd(g, t, into.raw, &d.memory.surfel_weights(), n, &surfels, true, into.gradients)?;
    let mut moves = vec![
        (d.log_colors, parameters.log_colors, Rate::Constant(o.rate)),
        (d.enclosure, parameters.enclosure, Rate::Constant(o.rate)),
    ];
    if o.gain_pull.is_some() {
        moves.push((d.log_gains, log_gains, Rate::Share(o.gains_rate)));
    }
    Ok(moves)
}

impl IntrinsicOptions {
    /// Returns the bytes of the light of a view with physical lights.
    pub fn view_light_bytes(&self) -> u64 {
        let pixels = u64::from(self.shape.largest[0]) * u64::from(self.shape.largest[1]);
        self.transport.map_or(0, |transport| transport.shape.view_bytes(pixels))
    }
}

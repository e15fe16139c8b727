//! `transport_solve`: radiosity and irradiance of all receivers. `transport_adjoint`: its gradient.
//!
//! Radiosity of receivers, as a radiance, is B = source + reflectance T B, irradiance pi T B, with the share of rays T. Gradients are those
//! of the transposed system: with the gradients g of radiosity and h of irradiance, m = reflectance g + pi h +
//! reflectance Tᵗ m. The gradient by the source is g + Tᵗ m; the one by the reflectance is that times T B.
//!
//! Chebyshev's iteration takes the root mean square of the reflectance for the spectral radius, and allows for the complex
//! eigenvalues that few rays cause. Iterations stop on the device: each records its largest relative change, and the
//! following ones skip lights whose change is within the tolerance. Every second one is preceded by a check that leaves no
//! workgroups if no light is left. Radiosity and irradiance are those of one more bounce, so that they are consistent with
//! each other.
//!
//! Cost of an iteration: 2 bytes (4 above 65535 receivers) and a texel per ray and light, three additions. All else is by
//! receiver: 52 bytes. Results are bit-identical from run to run.

use super::{MatrixColumns, MatrixRows, MatrixShape};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::ImageFormat;
use sgs_engine::graph::{Buffer, Graph, GraphError, Image, PassBuilder};
use sgs_shaders::{
    transport_adjoint as adjoint, transport_adjoint_begin as adjoint_begin, transport_adjoint_end as adjoint_end,
    transport_begin as begin, transport_bounce as bounce, transport_check as check, transport_end as end,
    transport_relaxation as relaxation,
};

/// Texels of a row of an image of values.
const WIDTH: u32 = 256;
/// Number of iterations before the first check of all lights.
const UNCHECKED: u32 = 5;
/// Number of iterations from one check to the next.
const CHECK_INTERVAL: u32 = 2;
/// Bytes of a record of dispatches, a multiple of the alignment of bindings.
const RECORD: u64 = 256;
/// Largest number of receivers whose reflectance estimates the spectral radius.
const SAMPLES: u32 = 2048;

/// Options of an iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveOptions {
    /// Largest number of iterations; 0 counts as 1.
    pub iterations: u32,
    /// Largest relative change of a value in the last iteration.
    pub tolerance: f32,
    /// Share of the largest value; changes of smaller values are relative to it.
    pub least: f32,
    /// Whether to use Chebyshev's iteration instead of Jacobi's.
    pub accelerated: bool,
}

impl Default for SolveOptions {
    fn default() -> Self {
        SolveOptions { iterations: 24, tolerance: 1e-3, least: 1e-3, accelerated: true }
    }
}

impl SolveOptions {
    /// Returns the largest number of iterations, at least one.
    fn count(&self) -> u32 {
        self.iterations.max(1)
    }
}

/// Inputs of [`transport_solve`].
#[derive(Clone, Copy, Debug)]
pub struct SolveInputs {
    /// Transport matrix.
    pub matrix: MatrixRows,
    /// Number of independent sets of light.
    pub lights: u32,
    /// Reflectance in [0, 1], `[receivers * 3]` floats.
    pub reflectance: Buffer,
    /// Direct light and emission as radiance, `[receivers * lights * 3]` floats.
    pub source: Buffer,
    /// First radiosity of the iteration, such as that of the last solve; the source if absent.
    pub initial: Option<Buffer>,
}

/// Outputs of [`transport_solve`].
#[derive(Clone, Copy, Debug)]
pub struct Solution {
    /// Radiosity in units of radiance, `[receivers * lights * 3]` floats.
    pub radiosity: Buffer,
    /// Irradiance of bounced light, `[receivers * lights * 3]` floats.
    pub irradiance: Buffer,
    /// Number of iterations and bits of the last relative change, `[lights * 2]` words.
    pub convergence: Buffer,
}

/// Inputs of [`transport_adjoint`].
#[derive(Clone, Copy, Debug)]
pub struct AdjointInputs {
    /// Columns of the transport matrix.
    pub matrix: MatrixColumns,
    /// Number of independent sets of light.
    pub lights: u32,
    /// Reflectance in [0, 1], `[receivers * 3]` floats.
    pub reflectance: Buffer,
    /// Irradiance that [`transport_solve`] returned, `[receivers * lights * 3]` floats.
    pub irradiance: Buffer,
    /// Gradient of the radiosity, `[receivers * lights * 3]` floats, if it has one.
    pub radiosity_gradient: Option<Buffer>,
    /// Gradient of the irradiance, `[receivers * lights * 3]` floats, if it has one.
    pub irradiance_gradient: Option<Buffer>,
}

/// Outputs of [`transport_adjoint`].
#[derive(Clone, Copy, Debug)]
pub struct SolveGradients {
    /// Gradient of the source, `[receivers * lights * 3]` floats.
    pub source: Buffer,
    /// Gradient of the reflectance, `[receivers * 3]` floats.
    pub reflectance: Buffer,
    /// Number of iterations and last relative change, as [`Solution::convergence`].
    pub convergence: Buffer,
}

/// Images of an iteration, a texel per receiver and light.
struct Images {
    /// Values of the last two iterations, in turn.
    values: [Image; 2],
    /// What the last iteration gathered.
    gathered: Image,
    source: Image,
    /// Reflectance, a texel per receiver.
    reflectance: Image,
}

/// Buffers and images of an iteration.
struct Iteration {
    shape: MatrixShape,
    lights: u32,
    images: Images,
    /// Largest change and value of each iteration.
    progress: Buffer,
    /// Weights of the iterations.
    relaxation: Buffer,
    /// Workgroups of the iterations after each check.
    dispatches: Buffer,
    tolerance: f32,
}

impl Iteration {
    /// Declares the buffers, clears the progress and computes the weights.
    fn new(
        g: &mut Graph,
        shape: MatrixShape,
        lights: u32,
        reflectance: Buffer,
        options: &SolveOptions,
    ) -> Result<Iteration, GraphError> {
        let iterations = options.count();
        let format = ImageFormat::Rgba32Float;
        let height = lights.saturating_mul(rows(shape));
        let image = |g: &mut Graph, name: &str| g.transient_image(name, [WIDTH, height], format);
        let values = ["transport.even", "transport.odd"].map(|name| image(g, name));
        let [gathered, source] = ["transport.gathered", "transport.source"].map(|name| image(g, name));
        let slots = u64::from(iterations + 2) * u64::from(lights);
        let progress = g.transient("transport.progress", 4 * slots);
        g.fill("transport.clear", progress, 0)?;
        let weights = g.transient("transport.relaxation", 4 * u64::from(iterations));
        let bindings = relaxation::Bindings { reflectance: reflectance.into(), relaxation: weights.into() };
        let push = relaxation::Push {
            receivers: shape.receivers,
            stride: shape.receivers.div_ceil(SAMPLES),
            iterations,
            share: if options.accelerated { focus(shape.rays) } else { 0.0 },
        };
        let (kernel, specs) = (&relaxation::KERNEL, relaxation::Specs { workgroup: 256 });
        stage(g, "transport_relaxation", kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .dispatch([1, 1, 1])?;
        let factors = g.transient_image("transport.reflectance", [WIDTH, rows(shape)], format);
        let dispatches = g.transient("transport.dispatches", RECORD * u64::from(iterations));
        g.fill("transport.clear_dispatches", dispatches, 0)?;
        let tolerance = options.tolerance;
        let images = Images { values, gathered, source, reflectance: factors };
        Ok(Iteration { shape, lights, images, progress, relaxation: weights, dispatches, tolerance })
    }

    /// Returns the groups for every receiver, and `more` texels, of every light.
    fn groups(&self, more: u32, per_group: u32) -> [u32; 3] {
        [(self.shape.receivers + more).div_ceil(per_group), self.lights, 1]
    }
}

/// Position of an iteration: where its workgroups are counted.
#[derive(Clone, Copy)]
enum Start {
    /// Known when the graph is built.
    Always([u32; 3]),
    /// Byte offset in the dispatches.
    Checked(u64),
}

impl Iteration {
    /// Adds the check before iteration `k`, if it has one. `before` is the start of the previous iteration.
    fn start(&self, g: &mut Graph, k: u32, groups: [u32; 3], before: Start) -> Result<Start, GraphError> {
        if k < UNCHECKED {
            return Ok(Start::Always(groups));
        }
        if !(k - UNCHECKED).is_multiple_of(CHECK_INTERVAL) {
            return Ok(before);
        }
        let offset = RECORD * u64::from((k - UNCHECKED) / CHECK_INTERVAL);
        let bindings =
            check::Bindings { progress: self.progress.into(), dispatches: self.dispatches.slice(offset, 24) };
        let push = check::Push { groups, lights: self.lights, iteration: k, tolerance: self.tolerance };
        let pass = stage(g, "transport_check", &check::KERNEL, bindings.entries(), [], bytemuck::bytes_of(&push));
        match before {
            Start::Always(_) => pass.dispatch([1, 1, 1])?,
            Start::Checked(offset) => pass.dispatch_indirect(self.dispatches, offset + 12)?,
        }
        Ok(Start::Checked(offset))
    }

    /// Binds what all iterations share, and adds the pass.
    fn add(&self, pass: PassBuilder<'_>, k: u32, start: Start) -> Result<(), GraphError> {
        let images = &self.images;
        let [current, next] = [k % 2, (k + 1) % 2].map(|i| images.values[i as usize]);
        let pass = pass
            .bind("relaxation", self.relaxation)
            .bind("progress", self.progress)
            .bind_image("current", current)
            .bind_image("next", next)
            .bind_image("source", images.source)
            .bind_image("reflectance", images.reflectance)
            .bind_image("gathered", images.gathered);
        match start {
            Start::Always(groups) => pass.dispatch(groups),
            Start::Checked(offset) => pass.dispatch_indirect(self.dispatches, offset),
        }
    }
}

/// Returns the focus of the ellipse of eigenvalues over the spectral radius.
///
/// The real eigenvalues of a matrix of random rays reach as far as the spectral radius, the complex ones about 1 / sqrt(rays)
/// of it. The ellipse has these semi-axes. If it were flat, iterations would diverge at a reflectance near 1.
fn focus(rays: u32) -> f32 {
    (1.0 - 1.0 / rays.max(1) as f32).sqrt()
}

/// Returns the rows of texels of a light.
fn rows(shape: MatrixShape) -> u32 {
    (shape.receivers + 1).div_ceil(WIDTH)
}

/// Returns the invocations of a workgroup. A CPU takes more time for many workgroups.
fn workgroup(t: &Tuning) -> u32 {
    t.workgroup.min(if t.narrow() { 256 } else { 64 })
}

/// Returns the lanes of a receiver in bounces. On narrow subgroups, one lane adds a whole row.
fn lanes(t: &Tuning) -> u32 {
    if t.narrow() { 1 } else { 8 }
}

/// Computes radiosity and irradiance.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound, or if there are too many lights for an image.
pub fn transport_solve(
    g: &mut Graph,
    t: &Tuning,
    a: &SolveInputs,
    options: &SolveOptions,
    into: &Solution,
) -> Result<(), GraphError> {
    let shape = a.matrix.shape;
    let it = Iteration::new(g, shape, a.lights, a.reflectance, options)?;
    let workgroup = workgroup(t);
    let push = begin::Push { receivers: shape.receivers, lights: a.lights, rows: rows(shape) };
    let specs = begin::Specs { workgroup };
    stage(g, "transport_begin", &begin::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push))
        .bind("initial", a.initial.unwrap_or(a.source))
        .bind("source_values", a.source)
        .bind("reflectance_values", a.reflectance)
        .bind("progress", it.progress)
        .bind_image("first", it.images.values[0])
        .bind_image("second", it.images.values[1])
        .bind_image("source", it.images.source)
        .bind_image("reflectance", it.images.reflectance)
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(it.groups(1, workgroup))?;
    let groups_of_step = it.groups(0, workgroup / lanes(t));
    let mut start = Start::Always(groups_of_step);
    for k in 0..options.count() {
        start = it.start(g, k, groups_of_step, start)?;
        let specs = bounce::Specs { workgroup, lanes: lanes(t), bits: shape.bits(), width: shape.width() };
        let push = bounce::Push {
            receivers: shape.receivers,
            lights: a.lights,
            rows: rows(shape),
            iteration: k,
            weight: 1.0 / shape.rays as f32,
            tolerance: options.tolerance,
            least: options.least,
        };
        let pass = stage(g, "transport_bounce", &bounce::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push))
            .bind("matrix_rows", a.matrix.rows)
            .subgroup_size(Some(t.subgroup_size));
        it.add(pass, k, start)?;
    }
    let push =
        end::Push { receivers: shape.receivers, lights: a.lights, rows: rows(shape), iterations: options.count() };
    let specs = end::Specs { workgroup };
    stage(g, "transport_end", &end::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push))
        .bind("progress", it.progress)
        .bind("convergence", into.convergence)
        .bind("source", a.source)
        .bind("reflectance", a.reflectance)
        .bind("radiosity", into.radiosity)
        .bind("irradiance", into.irradiance)
        .bind_image("gathered", it.images.gathered)
        .dispatch(groups(u64::from(shape.receivers) * u64::from(a.lights), workgroup))
}

/// Computes one bounce.
///
/// `radiosity` is source + reflectance T `initial`, and `irradiance` pi T `initial`.
///
/// # Errors
/// As [`transport_solve`].
pub fn transport_bounce(g: &mut Graph, t: &Tuning, a: &SolveInputs, into: &Solution) -> Result<(), GraphError> {
    transport_solve(g, t, a, &SolveOptions { iterations: 1, ..SolveOptions::default() }, into)
}

/// Computes the gradients of source and reflectance.
///
/// # Errors
/// As [`transport_solve`].
pub fn transport_adjoint(
    g: &mut Graph,
    t: &Tuning,
    a: &AdjointInputs,
    options: &SolveOptions,
    into: &SolveGradients,
) -> Result<(), GraphError> {
    let shape = a.matrix.shape;
    let (receivers, lights) = (shape.receivers, a.lights);
    let it = Iteration::new(g, shape, lights, a.reflectance, options)?;
    let workgroup = workgroup(t);
    let push = adjoint_begin::Push { receivers, lights, rows: rows(shape) };
    let specs = adjoint_begin::Specs {
        workgroup,
        by_radiosity: a.radiosity_gradient.is_some(),
        by_irradiance: a.irradiance_gradient.is_some(),
    };
    let kernel = &adjoint_begin::KERNEL;
    stage(g, "transport_adjoint_begin", kernel, [], specs.entries(), bytemuck::bytes_of(&push))
        .bind("reflectance_values", a.reflectance)
        .bind("radiosity_gradient", a.radiosity_gradient.unwrap_or(a.irradiance))
        .bind("irradiance_gradient", a.irradiance_gradient.unwrap_or(a.irradiance))
        .bind("progress", it.progress)
        .bind_image("first", it.images.values[0])
        .bind_image("second", it.images.values[1])
        .bind_image("source", it.images.source)
        .bind_image("reflectance", it.images.reflectance)
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(it.groups(1, workgroup))?;
    let groups_of_step = it.groups(0, workgroup / 8);
    let mut start = Start::Always(groups_of_step);
    for k in 0..options.count() {
        start = it.start(g, k, groups_of_step, start)?;
        let specs = adjoint::Specs { workgroup, lanes: 8 };
        let push = adjoint::Push {
            receivers,
            lights,
            rows: rows(shape),
            iteration: k,
            weight: 1.0 / shape.rays as f32,
            tolerance: options.tolerance,
            least: options.least,
        };
        let pass = stage(g, "transport_adjoint", &adjoint::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push))
            .bind("column_starts", a.matrix.starts)
            .bind("column_rows", a.matrix.rows)
            .subgroup_size(Some(t.subgroup_size));
        it.add(pass, k, start)?;
    }
    let push = adjoint_end::Push { receivers, lights, rows: rows(shape), iterations: options.count() };
    let specs = adjoint_end::Specs { workgroup, by_radiosity: a.radiosity_gradient.is_some() };
    stage(g, "transport_adjoint_end", &adjoint_end::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push))
        .bind("progress", it.progress)
        .bind("convergence", into.convergence)
        .bind("radiosity_gradient", a.radiosity_gradient.unwrap_or(a.irradiance))
        .bind("irradiance", a.irradiance)
        .bind("source_gradient", into.source)
        .bind("reflectance_gradient", into.reflectance)
        .bind_image("gathered", it.images.gathered)
        .dispatch(groups(receivers.into(), workgroup))
}

//! Per-view surfaces of fixed geometry: surfaces by pixel, and the weights of the Gaussians by row and by column.
//!
//! Surfaces are computed once per view and stored, or recomputed before each step if memory is short. Both use the same
//! pass and inputs, so results are bitwise equal. Storing waits for the device, because the host needs the number of
//! weights; with known capacity nothing waits.

use super::{PSEUDO_VIEWS, Step};
use crate::Tuning;
use crate::scene::{Gaussians, Handles, Layout};
use crate::shade::{GBUFFER_CHANNELS, Room, Surfaces, Weights, gbuffer, unpacked_weights, weight_words, weights};
use crate::splat::{Blended, Screen, blend, intersect, project};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::Camera;
use std::sync::Arc;

/// Dimensions of a view's surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfaceShape {
    /// Maximum columns and rows of a view.
    pub largest: [u32; 2],
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Capacity of weights.
    pub weights: u32,
    /// Bits per weight, 32 or 16 ([`crate::Accuracy::weight_bits`]).
    pub weight_bits: u32,
}

/// Names of the buffers, in the order of [`SurfaceShape::bytes`].
const NAMES: [&str; 9] = [
    "surface_points",
    "surface_normals",
    "surface_coverage",
    "row_starts",
    "columns",
    "weights",
    "column_starts",
    "rows",
    "row_weights",
];

impl SurfaceShape {
    fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }

    fn each(&self) -> [u64; NAMES.len()] {
        let (p, w) = (self.pixels(), 4 * u64::from(self.weights.max(1)));
        let weight_bytes = 4 * weight_words(self.weights.max(1), self.weight_bits);
        [12 * p, 12 * p, 4 * p, 4 * (p + 1), w, weight_bytes, 4 * (u64::from(self.gaussians) + 1), w, weight_bytes]
    }

    /// Returns the bytes of one view's surfaces.
    pub fn bytes(&self) -> u64 {
        self.each().iter().sum()
    }

    /// Declares the surfaces of a view in a graph; `written` if one of its passes fills them.
    pub fn declare(&self, g: &mut Graph, prefix: &str, written: bool) -> SurfaceHandles {
        let mut at = NAMES.iter().zip(self.each()).map(|(name, bytes)| {
            let name = format!("{prefix}{name}");
            if written { g.external(name, bytes) } else { g.input(name, bytes) }
        });
        let mut next = || at.next().unwrap_or_else(|| unreachable!("invariant: nine buffers have nine names"));
        let surfaces = Surfaces { points: next(), normals: next(), coverage: next() };
        let weights = Weights {
            row_starts: next(),
            columns: next(),
            weights: next(),
            column_starts: next(),
            rows: next(),
            row_weights: next(),
            bits: self.weight_bits,
        };
        SurfaceHandles { surfaces, weights }
    }
}

/// Handles of a view's surfaces in one graph.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceHandles {
    /// Surfaces by pixel.
    pub surfaces: Surfaces,
    /// Weight matrix.
    pub weights: Weights,
}

impl SurfaceHandles {
    fn buffers(&self) -> [Buffer; NAMES.len()] {
        let (s, w) = (&self.surfaces, &self.weights);
        [s.points, s.normals, s.coverage, w.row_starts, w.columns, w.weights, w.column_starts, w.rows, w.row_weights]
    }
}

/// Surfaces of a view in device memory.
#[derive(Clone, Debug)]
pub struct Surface {
    shape: SurfaceShape,
    buffers: Vec<DeviceBuffer>,
}

impl Surface {
    /// Allocates the surfaces of a view.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, shape: SurfaceShape) -> Result<Surface> {
        let make = |(name, bytes): (&&str, u64)| device.buffer(name, bytes, Location::Device);
        let buffers = NAMES.iter().zip(shape.each()).map(make).collect::<Result<_>>()?;
        Ok(Surface { shape, buffers })
    }

    /// Creates a surface with one opaque pixel per Gaussian, at its center.
    ///
    /// Pixel `i` is Gaussian `i`; the rest of the last row is empty. `points` and `normals` hold three floats per
    /// Gaussian; normals are unit or zero. Used for colors by Gaussian instead of by view.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn of_gaussians(device: &Device, points: &[f32], normals: &[f32], capacity: u32) -> Result<Surface> {
        let count = (points.len() / 3) as u32;
        let width = count.isqrt().max(1);
        let largest = [width, count.div_ceil(width).max(1)];
        let shape = SurfaceShape { largest, gaussians: capacity, weights: count, weight_bits: 32 };
        let surface = Surface::new(device, shape)?;
        let pixels = shape.pixels() as usize;
        let floats = |source: &[f32], length: usize| {
            let mut all = source.to_vec();
            all.resize(length, 0.0);
            all
        };
        let ones = vec![1.0_f32; count as usize];
        let values = [floats(points, 3 * pixels), floats(normals, 3 * pixels), floats(&ones, pixels)];
        let starts = |n: usize| (0..=n as u32).map(|i| i.min(count)).collect::<Vec<u32>>();
        let (each, rows, columns) = (starts(count as usize), starts(pixels), starts(capacity as usize));
        for (buffer, values) in surface.buffers.iter().zip(&values) {
            device.upload(buffer, 0, bytemuck::cast_slice(values))?;
        }
        for (i, words) in [(3, &rows), (6, &columns)] {
            device.upload(&surface.buffers[i], 0, bytemuck::cast_slice(words))?;
        }
        if count > 0 {
            for i in [4, 7] {
                device.upload(&surface.buffers[i], 0, bytemuck::cast_slice(&each[..count as usize]))?;
            }
            for i in [5, 8] {
                device.upload(&surface.buffers[i], 0, bytemuck::cast_slice(&ones))?;
            }
        }
        Ok(surface)
    }

    /// Returns the dimensions.
    pub fn shape(&self) -> SurfaceShape {
        self.shape
    }

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was compiled for larger buffers.
    pub fn bind(&self, exec: &mut Executor, handles: &SurfaceHandles) -> Result<()> {
        handles.buffers().iter().zip(&self.buffers).try_for_each(|(handle, buffer)| exec.bind(*handle, buffer))
    }

    /// Binds the buffers for replays that alternate between surfaces.
    ///
    /// Uses [`Executor::alternate`].
    ///
    /// # Errors
    /// If the plan was compiled for larger buffers.
    pub fn alternate(&self, exec: &mut Executor, handles: &SurfaceHandles) -> Result<()> {
        handles.buffers().iter().zip(&self.buffers).try_for_each(|(handle, buffer)| exec.alternate(*handle, buffer))
    }

    /// Downloads points, normals and coverage (waits for the device).
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<[Vec<f32>; 3]> {
        let pixels = self.shape.pixels() as usize;
        Ok([
            device.download_as(&self.buffers[0], 3 * pixels)?,
            device.download_as(&self.buffers[1], 3 * pixels)?,
            device.download_as(&self.buffers[2], pixels)?,
        ])
    }

    /// Downloads the weights (waits for the device).
    ///
    /// # Errors
    /// If the device fails.
    pub fn weights(&self, device: &Device) -> Result<WeightColumns> {
        let starts: Vec<u32> = device.download_as(&self.buffers[6], self.shape.gaussians as usize + 1)?;
        let count = starts.last().map_or(0, |n| *n as usize);
        let (pixels, weights): (Vec<u32>, Vec<u32>) = match count {
            0 => Default::default(),
            n => {
                let words = weight_words(n as u32, self.shape.weight_bits) as usize;
                (device.download_as(&self.buffers[7], n)?, device.download_as::<u32>(&self.buffers[8], words)?)
            }
        };
        let weights = match self.shape.weight_bits {
            16 => unpacked_weights(&weights, count),
            _ => weights.into_iter().map(f32::from_bits).collect(),
        };
        Ok(WeightColumns { starts, pixels, weights })
    }
}

/// Weights of a view on the host, by Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WeightColumns {
    /// Index of each Gaussian's first weight, then the total number of weights.
    pub starts: Vec<u32>,
    /// Pixel of each weight.
    pub pixels: Vec<u32>,
    /// Contribution of the Gaussian to the pixel's surface.
    pub weights: Vec<f32>,
}

impl WeightColumns {
    /// Returns the pixels and weights of a Gaussian.
    pub fn of(&self, gaussian: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let range = self.starts[gaussian] as usize..self.starts[gaussian + 1] as usize;
        self.pixels[range.clone()].iter().map(|p| *p as usize).zip(self.weights[range].iter().copied())
    }
}

/// Builder that fills surfaces, view by view.
pub struct SurfaceBuilder {
    device: Device,
    tuning: Tuning,
    shape: SurfaceShape,
    entry_capacity: u32,
    state: State,
}

struct State {
    exec: Executor,
    step: Buffer,
    gaussians: Handles,
    into: SurfaceHandles,
    /// Overflow flag.
    flags: DeviceBuffer,
    /// Required entries and required weights.
    wanted: [DeviceBuffer; 2],
}

impl SurfaceBuilder {
    /// Prepares for views of at most `largest` columns and rows. The Gaussians must have normals.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, tuning: Tuning, gaussians: &Gaussians, largest: [u32; 2]) -> Result<SurfaceBuilder> {
        let pixels = u64::from(largest[0]) * u64::from(largest[1]);
        let guess = u32::try_from(8 * pixels).unwrap_or(u32::MAX).max(1 << 10);
        let weight_bits = tuning.accuracy.weight_bits;
        let shape = SurfaceShape { largest, gaussians: gaussians.capacity, weights: guess, weight_bits };
        let entry_capacity = gaussians.capacity.saturating_mul(2).clamp(1 << 12, 1 << 24);
        let state = State::new(device, &tuning, gaussians, shape, entry_capacity)?;
        Ok(SurfaceBuilder { device: device.clone(), tuning, shape, entry_capacity, state })
    }

    /// Compiles the plan of a builder without creating it, to estimate its cost.
    ///
    /// # Errors
    /// If the graph rejects the sizes.
    pub fn plan(t: &Tuning, gaussians: &Layout, shape: SurfaceShape, entry_capacity: u32) -> Result<Arc<Plan>> {
        Ok(declare(t, gaussians, shape, entry_capacity)?.plan)
    }

    /// Returns the dimensions that the measured views require.
    ///
    /// See [`SurfaceBuilder::measure`].
    pub fn shape(&self) -> SurfaceShape {
        self.shape
    }

    /// Returns the plan; [`SurfaceBuilder::BYTES`] adds to its arena and uniforms.
    pub fn compiled(&self) -> &Plan {
        self.state.exec.plan()
    }

    /// Bytes of the flag and the required counts.
    pub const BYTES: u64 = 12;

    /// Views in flight: a training step needs its own and its pseudo-views.
    pub const FRAMES: usize = 1 + PSEUDO_VIEWS;

    /// Grows the capacity until a view fits (waits for the device). Earlier views still fit.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn measure(&mut self, gaussians: &Gaussians, camera: &Camera) -> Result<()> {
        loop {
            let scratch = Surface::new(&self.device, self.shape)?;
            self.fill(gaussians, camera, &scratch)?;
            self.state.exec.finish()?;
            if self.device.download_as::<u32>(&self.state.flags, 1)?[0] == 0 {
                return Ok(());
            }
            let mut wanted = [0; 2];
            for (value, buffer) in wanted.iter_mut().zip(&self.state.wanted) {
                *value = self.device.download_as::<u32>(buffer, 1)?[0];
            }
            let more = |room: u32, wanted: u32| if wanted > room { wanted.saturating_add(wanted / 16) } else { room };
            self.entry_capacity = more(self.entry_capacity, wanted[0]);
            self.shape.weights = more(self.shape.weights, wanted[1]);
            self.state = State::new(&self.device, &self.tuning, gaussians, self.shape, self.entry_capacity)?;
        }
    }

    /// Sets the capacity of weights to this number, the maximum over the views.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn fit(&mut self, gaussians: &Gaussians, weights: u32) -> Result<()> {
        if weights != self.shape.weights {
            self.shape.weights = weights.max(1);
            self.state = State::new(&self.device, &self.tuning, gaussians, self.shape, self.entry_capacity)?;
        }
        Ok(())
    }

    /// Returns the number of weights required by the last measured view.
    ///
    /// Waits for the device.
    ///
    /// # Errors
    /// If the device fails.
    pub fn wanted(&self) -> Result<u32> {
        Ok(self.device.download_as::<u32>(&self.state.wanted[1], 1)?[0])
    }

    /// Fills `into`, which has the builder's shape, without waiting. The view must have been measured.
    ///
    /// Waits for the view before if that filled another surface.
    ///
    /// # Errors
    /// If the device fails.
    pub fn fill(&mut self, gaussians: &Gaussians, camera: &Camera, into: &Surface) -> Result<()> {
        into.bind(&mut self.state.exec, &self.state.into)?;
        self.submit(gaussians, camera)
    }

    /// Like [`SurfaceBuilder::fill`], for surfaces that are filled repeatedly.
    ///
    /// Never waits for the view before, and keeps the surfaces alive.
    ///
    /// # Errors
    /// If the device fails.
    pub fn fill_again(&mut self, gaussians: &Gaussians, camera: &Camera, into: &Surface) -> Result<()> {
        into.alternate(&mut self.state.exec, &self.state.into)?;
        self.submit(gaussians, camera)
    }

    fn submit(&mut self, gaussians: &Gaussians, camera: &Camera) -> Result<()> {
        gaussians.bind(&mut self.state.exec, &self.state.gaussians)?;
        let mut camera = *camera;
        let tile = self.tuning.tile;
        camera.tiles = [camera.size[0].div_ceil(tile[0]), camera.size[1].div_ceil(tile[1])];
        let step = Step { camera, step: 1, ..Default::default() };
        self.state.exec.submit(&[(self.state.step, bytemuck::bytes_of(&step))])?;
        Ok(())
    }

    /// Waits for the submitted work.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> Result<()> {
        self.state.exec.finish()
    }
}

impl State {
    fn new(
        device: &Device,
        t: &Tuning,
        gaussians: &Gaussians,
        shape: SurfaceShape,
        entry_capacity: u32,
    ) -> Result<State> {
        let declared = declare(t, &gaussians.layout(), shape, entry_capacity)?;
        let Declared { plan, step, gaussians: handles, into, flags, wanted } = declared;
        let make = |name: &str| device.buffer(name, 4, Location::Device);
        let (flag_memory, wanted_memory) = (make("flags")?, [make("wanted_entries")?, make("wanted_weights")?]);
        let mut exec = Executor::new(
            device,
            plan,
            ExecOptions { frames_in_flight: SurfaceBuilder::FRAMES, ..Default::default() },
        )?;
        exec.bind(flags, &flag_memory)?;
        for (handle, memory) in wanted.iter().zip(&wanted_memory) {
            exec.bind(*handle, memory)?;
        }
        Ok(State { exec, step, gaussians: handles, into, flags: flag_memory, wanted: wanted_memory })
    }
}

/// Compiled builder and the handles to bind.
struct Declared {
    plan: Arc<Plan>,
    step: Buffer,
    gaussians: Handles,
    into: SurfaceHandles,
    flags: Buffer,
    wanted: [Buffer; 2],
}

fn declare(t: &Tuning, gaussians: &Layout, shape: SurfaceShape, entry_capacity: u32) -> Result<Declared> {
    let mut g = Graph::new("surface");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: shape.largest, tile: t.tile };
    let handles = gaussians.declare(&mut g, false);
    let flags = g.external("flags", 4);
    let wanted = ["wanted_entries", "wanted_weights"].map(|name| g.external(name, 4));
    let into = shape.declare(&mut g, "", true);
    g.fill("clear_flags", flags, 0)?;
    let visible = project(&mut g, t, &screen, &handles, GBUFFER_CHANNELS)?;
    let entries = intersect(&mut g, t, &screen, &visible, entry_capacity, flags)?;
    let blended = Blended {
        image: g.transient("image", 4 * u64::from(GBUFFER_CHANNELS.count()) * screen.pixels()),
        transmittance: g.transient("transmittance", 4 * screen.pixels()),
    };
    blend(&mut g, t, &screen, &visible, &entries, &blended)?;
    gbuffer(&mut g, t, &screen, &blended, &into.surfaces)?;
    let room = Room { capacity: shape.weights, gaussians: shape.gaussians, flags, wanted: wanted[1] };
    weights(&mut g, t, &screen, &visible, &entries, into.surfaces.coverage, &room, &into.weights)?;
    g.copy("copy_wanted", entries.wanted, wanted[0])?;
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Declared { plan, step, gaussians: handles, into, flags, wanted })
}

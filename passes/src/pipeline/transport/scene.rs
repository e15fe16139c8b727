//! Transport matrix of surfels in an enclosure, and radiosity with it.

use crate::Tuning;
use crate::transport::{
    AreaLight, AreaLights, Enclosure, LightReceivers, MatrixRows, MatrixShape, Outside, OutsideHandles, OutsideMemory,
    OutsideShape, ReflectionRays, ShadowRays, Solution, SolveInputs, SolveOptions, SurfelHandles, SurfelMemory,
    SurfelTree, SurfelTreeShape, Surfels, TransportRays, parts_of, receivers, transport_lights, transport_rays,
    transport_rows, transport_solve,
};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::f32::consts::PI;
use std::sync::Arc;

/// Number of lights that a solve takes at once.
const BATCH: usize = 16;
/// Number of rays of a reflecting pixel that is no mirror.
const REFLECTION_RAYS: u32 = 8;
/// Roughness below which a pixel has one ray.
const MIRROR: f32 = 0.1;
/// Roughness from which reflections fade.
const FADE: f32 = 0.25;
/// Roughness from which there are none.
const DIFFUSE: f32 = 0.35;

/// Options of a [`TransportScene`]. Lengths are in the unit of the surfels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransportOptions {
    /// Number of rays of a receiver.
    pub rays: u32,
    /// Number of sample points of a light with an extent.
    pub samples: u32,
    /// Seed of rays and sample points.
    pub seed: u32,
    /// Distance above a receiver at which rays begin.
    pub offset: f32,
    /// Distance before a light at which shadow rays end.
    pub clearance: f32,
}

/// Surfels of a room in device memory, with their transport matrix. Clones share the memory.
#[derive(Clone)]
pub struct TransportScene {
    device: Device,
    tuning: Tuning,
    options: TransportOptions,
    tree_shape: SurfelTreeShape,
    tree: SurfelMemory,
    enclosure: Enclosure,
    receivers: DeviceBuffer,
    shape: MatrixShape,
    rows: DeviceBuffer,
    targets: DeviceBuffer,
    outside: OutsideMemory,
}

impl std::fmt::Debug for TransportScene {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TransportScene")
            .field("shape", &self.shape)
            .field("options", &self.options)
            .finish_non_exhaustive()
    }
}

/// Graph whose inputs are uploaded before its only run.
struct Once<'a> {
    device: &'a Device,
    g: Graph,
    memory: Vec<(Buffer, DeviceBuffer)>,
}

impl<'a> Once<'a> {
    fn new(device: &'a Device, name: &str) -> Once<'a> {
        Once { device, g: Graph::new(name), memory: Vec::new() }
    }

    /// Uploads the contents of a declared input.
    fn upload(&mut self, handle: Buffer, name: &str, bytes: &[u8]) -> Result<()> {
        let buffer = self.device.buffer(name, bytes.len().max(4) as u64, Location::Device)?;
        if !bytes.is_empty() {
            self.device.upload(&buffer, 0, bytes)?;
        }
        self.memory.push((handle, buffer));
        Ok(())
    }

    /// Declares an input with these contents.
    fn input(&mut self, name: &str, bytes: &[u8]) -> Result<Buffer> {
        let handle = self.g.input(name, bytes.len().max(4) as u64);
        self.upload(handle, name, bytes)?;
        Ok(handle)
    }

    /// Declares an output and allocates it.
    fn output(&mut self, name: &str, bytes: u64) -> Result<(Buffer, DeviceBuffer)> {
        let handle = self.g.external(name, bytes.max(4));
        let buffer = self.device.buffer(name, bytes.max(4), Location::Device)?;
        self.memory.push((handle, buffer.clone()));
        Ok((handle, buffer))
    }

    /// Runs the graph and waits for it. `bind` binds buffers that live elsewhere.
    fn run(self, bind: impl FnOnce(&mut Executor) -> Result<()>) -> Result<()> {
        let plan = Arc::new(self.g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(self.device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        for (handle, buffer) in &self.memory {
            exec.bind(*handle, buffer)?;
        }
        bind(&mut exec)?;
        exec.submit(&[])?;
        exec.finish()
    }
}

impl TransportScene {
    /// Uploads the surfels and traces the transport matrix. The room has no openings ([`TransportScene::with_outside`]).
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn new(
        device: &Device,
        tuning: Tuning,
        (surfels, tree): (&Surfels, &SurfelTree),
        enclosure: &Enclosure,
        options: TransportOptions,
    ) -> Result<TransportScene> {
        let memory = SurfelMemory::new(device, tree)?;
        let records = receivers(surfels, enclosure);
        let of_receivers = device.buffer("receivers", 4 * records.len() as u64, Location::Device)?;
        device.upload(&of_receivers, 0, bytemuck::cast_slice(&records))?;
        let count = (records.len() / 8) as u32;
        let shape = MatrixShape { receivers: count, rays: options.rays };
        let mut once = Once::new(device, "transport_matrix");
        let handles = SurfelHandles::declare(&mut once.g, &tree.shape());
        let all = once.g.input("receivers", of_receivers.bytes());
        let rays = TransportRays {
            tree: handles,
            receivers: all,
            enclosure: *enclosure,
            surfels: surfels.len() as u32,
            rays: options.rays,
            seed: options.seed,
            offset: options.offset,
        };
        let (targets, of_targets) = once.output("targets", rays.target_bytes())?;
        let (rows, of_rows) = once.output("matrix_rows", shape.bytes())?;
        transport_rays(&mut once.g, &tuning, &rays, targets)?;
        transport_rows(&mut once.g, &tuning, targets, &MatrixRows { shape, rows })?;
        once.run(|exec| {
            memory.bind(exec, &handles)?;
            exec.bind(all, &of_receivers)
        })?;
        Ok(TransportScene {
            device: device.clone(),
            tuning,
            options,
            tree_shape: tree.shape(),
            tree: memory,
            enclosure: *enclosure,
            receivers: of_receivers,
            shape,
            rows: of_rows,
            targets: of_targets,
            outside: OutsideMemory::new(device, &Outside::default())?,
        })
    }

    /// Sets the openings of the room and the environment behind them.
    ///
    /// They are in the unit of the surfels.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_outside(mut self, outside: &Outside) -> Result<TransportScene> {
        self.outside = OutsideMemory::new(&self.device, outside)?;
        Ok(self)
    }

    /// Returns the sizes of openings and environment.
    pub(super) fn outside_shape(&self) -> OutsideShape {
        self.outside.shape()
    }

    /// Returns openings and environment.
    pub(super) fn outside(&self) -> &OutsideMemory {
        &self.outside
    }

    /// Returns the same scene in which no light arrives from receivers from `count` on.
    ///
    /// With the number of surfels the enclosure is black; with 0 light does not bounce.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn lit_by_first(self, count: u32) -> Result<TransportScene> {
        let targets: Vec<u32> =
            self.targets()?.into_iter().map(|met| if met < count { met } else { u32::MAX }).collect();
        self.device.upload(&self.targets, 0, bytemuck::cast_slice(&targets))?;
        let mut once = Once::new(&self.device, "transport_rows");
        let of_targets = once.g.input("targets", self.targets.bytes());
        let rows = once.g.external("matrix_rows", self.rows.bytes());
        transport_rows(&mut once.g, &self.tuning, of_targets, &MatrixRows { shape: self.shape, rows })?;
        once.run(|exec| {
            exec.bind(of_targets, &self.targets)?;
            exec.bind(rows, &self.rows)
        })?;
        Ok(self)
    }

    /// Returns the bytes of the tree, the receivers and the rays. The rows of the matrix do not count.
    pub(super) fn bytes(&self) -> u64 {
        let SurfelTreeShape { node_bytes, disc_bytes } = self.tree_shape;
        node_bytes + disc_bytes + self.receivers.bytes() + self.targets.bytes()
    }

    /// Returns the number of receivers: surfels, then patches.
    pub fn receivers(&self) -> u32 {
        self.shape.receivers
    }

    /// Returns the rows of the transport matrix.
    pub(super) fn matrix_rows(&self) -> &DeviceBuffer {
        &self.rows
    }

    /// Returns the size of the transport matrix.
    pub(super) fn matrix(&self) -> MatrixShape {
        self.shape
    }

    /// Returns the choices for the device.
    pub(super) fn tuning(&self) -> &Tuning {
        &self.tuning
    }

    /// Returns the options.
    pub fn options(&self) -> &TransportOptions {
        &self.options
    }

    /// Downloads the receiver that each ray meets, `[receivers * rays]`.
    ///
    /// # Errors
    /// If the device fails.
    pub fn targets(&self) -> Result<Vec<u32>> {
        self.device.download_as(&self.targets, self.shape.receivers as usize * self.shape.rays as usize)
    }

    /// Returns the rays of lights as passes take them.
    pub(super) fn shadow_rays(&self, tree: SurfelHandles, outside: OutsideHandles) -> ShadowRays {
        let TransportOptions { samples, seed, offset, clearance, .. } = self.options;
        ShadowRays { tree, outside, offset, clearance, samples, seed }
    }

    /// Returns the rays of reflections as passes take them.
    pub(super) fn reflection_rays(&self, tree: SurfelHandles, radiosity: Buffer) -> ReflectionRays {
        let TransportOptions { seed, offset, .. } = self.options;
        ReflectionRays {
            tree,
            enclosure: self.enclosure,
            surfels: self.shape.receivers - self.enclosure.patch_count(),
            radiosity,
            offset,
            // Discs of one surface are within `offset` of it, on either side.
            window: 2.0 * offset,
            seed,
            rays: REFLECTION_RAYS,
            mirror: MIRROR,
            fade: FADE,
            diffuse: DIFFUSE,
        }
    }

    /// Returns the shape of the matrix.
    pub(super) fn shape(&self) -> MatrixShape {
        self.shape
    }

    /// Returns the rows of the matrix.
    pub(super) fn row_memory(&self) -> &DeviceBuffer {
        &self.rows
    }

    /// Returns the records of the receivers.
    pub(super) fn receiver_memory(&self) -> &DeviceBuffer {
        &self.receivers
    }

    /// Returns the shape of the tree.
    pub(super) fn tree_shape(&self) -> &SurfelTreeShape {
        &self.tree_shape
    }

    /// Returns the tree.
    pub(super) fn tree(&self) -> &SurfelMemory {
        &self.tree
    }

    /// Returns the irradiance of each receiver from each part of color 1.
    ///
    /// [`parts_of`] returns the parts of the lights.
    ///
    /// The result holds `[parts * receivers]` floats.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn unit_light(&self, lights: &[AreaLight]) -> Result<Vec<f32>> {
        self.unit(lights, &self.receivers, self.shape.receivers)
    }

    /// Returns the irradiance of each point from each part of the lights of color 1.
    ///
    /// The result holds `[parts * points]` floats. Normals are unit vectors.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn unit_light_at(&self, lights: &[AreaLight], points: &[[f32; 3]], normals: &[[f32; 3]]) -> Result<Vec<f32>> {
        let record = |(p, n): (&[f32; 3], &[f32; 3])| [p[0], p[1], p[2], 0.0, n[0], n[1], n[2], 0.0];
        let records: Vec<f32> = points.iter().zip(normals).flat_map(record).collect();
        if records.is_empty() {
            return Ok(Vec::new());
        }
        let buffer = self.device.buffer("points", 4 * records.len() as u64, Location::Device)?;
        self.device.upload(&buffer, 0, bytemuck::cast_slice(&records))?;
        self.unit(lights, &buffer, (records.len() / 8) as u32)
    }

    fn unit(&self, lights: &[AreaLight], receivers: &DeviceBuffer, count: u32) -> Result<Vec<f32>> {
        if lights.is_empty() {
            return Ok(Vec::new());
        }
        let mut once = Once::new(&self.device, "unit_light");
        let tree = SurfelHandles::declare(&mut once.g, &self.tree_shape);
        let outside = OutsideHandles::declare(&mut once.g, self.outside.shape());
        let of_lights = AreaLights::declare(&mut once.g, parts_of(lights).len() as u32);
        for (handle, bytes) in of_lights.contents(lights) {
            once.upload(handle, "lights", &bytes)?;
        }
        let all = once.g.input("receivers", receivers.bytes());
        let values = of_lights.count as usize * count as usize;
        let (unit, of_unit) = once.output("unit", 4 * values as u64)?;
        let to = LightReceivers::Surfels { receivers: all, count };
        transport_lights(&mut once.g, self.tuning, &to, &of_lights, &self.shadow_rays(tree, outside), None, unit)?;
        once.run(|exec| {
            self.tree.bind(exec, &tree)?;
            self.outside.bind(exec, &outside)?;
            exec.bind(all, receivers)
        })?;
        self.device.download_as(&of_unit, values)
    }

    /// Returns the bounced irradiance from each part of the lights of color 1.
    ///
    /// The result holds `[parts * receivers * 3]` floats.
    ///
    /// `reflectance` holds `[receivers * 3]` floats, `unit` those of [`TransportScene::unit_light`].
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn responses(&self, reflectance: &[f32], unit: &[f32], options: &SolveOptions) -> Result<Vec<f32>> {
        let count = self.shape.receivers as usize;
        let mut all = Vec::with_capacity(3 * unit.len());
        for batch in unit.chunks(BATCH * count) {
            let lights = batch.len() / count;
            let mut source = vec![0.0; 3 * batch.len()];
            for (at, value) in source.iter_mut().enumerate() {
                let (i, light, c) = (at / (3 * lights), at / 3 % lights, at % 3);
                *value = batch[light * count + i] * reflectance[3 * i + c] / PI;
            }
            let found = self.solve_lights(reflectance, &source, lights as u32, options)?;
            for light in 0..lights {
                all.extend((0..3 * count).map(|at| found[3 * (at / 3 * lights + light) + at % 3]));
            }
        }
        Ok(all)
    }

    /// Returns the irradiance that arrives by bounces, `[receivers * 3]` floats.
    ///
    /// `reflectance` and `source` hold `[receivers * 3]` floats. `source` is the radiosity without bounces: reflectance / pi
    /// times direct irradiance, plus emitted radiance.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn solve(&self, reflectance: &[f32], source: &[f32], options: &SolveOptions) -> Result<Vec<f32>> {
        self.solve_lights(reflectance, source, 1, options)
    }

    /// Solves several lights. Source and result hold `[receivers * lights * 3]` floats.
    fn solve_lights(
        &self,
        reflectance: &[f32],
        source: &[f32],
        lights: u32,
        options: &SolveOptions,
    ) -> Result<Vec<f32>> {
        let mut once = Once::new(&self.device, "transport_solve");
        let rows = once.g.input("matrix_rows", self.rows.bytes());
        let inputs = SolveInputs {
            matrix: MatrixRows { shape: self.shape, rows },
            lights,
            reflectance: once.input("reflectance", bytemuck::cast_slice(reflectance))?,
            source: once.input("source", bytemuck::cast_slice(source))?,
            initial: None,
        };
        let values = 3 * self.shape.receivers as usize * lights as usize;
        let (irradiance, of_irradiance) = once.output("irradiance", 4 * values as u64)?;
        let radiosity = once.g.transient("radiosity", 4 * values as u64);
        let convergence = once.g.transient("convergence", 8 * u64::from(lights));
        let into = Solution { radiosity, irradiance, convergence };
        transport_solve(&mut once.g, &self.tuning, &inputs, options, &into)?;
        once.run(|exec| exec.bind(rows, &self.rows))?;
        self.device.download_as(&of_irradiance, values)
    }
}

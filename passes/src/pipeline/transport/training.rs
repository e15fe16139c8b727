//! Device memory of the transport of training, and the light of its views.

use super::TransportScene;
use crate::pipeline::{Step, Surface, SurfaceHandles, SurfaceShape};
use crate::shade::Weights;
use crate::splat::Screen;
use crate::transport::{
    AreaLight, AreaLights, GatherColumns, LightReceivers, MatrixColumns, MatrixRows, MatrixShape, NEIGHBORS, Nearest,
    OutsideHandles, SurfelHandles, split_sum_table, transport_lights, transposed,
};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::{Camera, LightRecord};
use std::sync::Arc;

/// Sizes of a [`TransportMemory`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransportShape {
    /// Number of physical lights.
    pub lights: u32,
    /// Number of surfels.
    pub surfels: u32,
    /// Size of the transport matrix.
    pub matrix: MatrixShape,
    /// Number of rays that meet a receiver.
    pub met: u32,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Number of weights of the Gaussians at their nearest surfels.
    pub gathered: u32,
    /// Number of weights of the surfels' nearest Gaussians.
    pub described: u32,
    /// Bytes of the tree, the receivers and their rays. They lie beside the buffers of a step.
    pub scene_bytes: u64,
}

/// What a training step needs of a room, on the host.
#[derive(Clone, Copy, Debug)]
pub struct TransportContents<'a> {
    /// Lights in the scene's unit.
    pub lights: &'a [AreaLight],
    /// Number of surfels.
    pub surfels: u32,
    /// Face of each patch of the enclosure.
    pub faces: &'a [u32],
    /// Nearest surfels of each Gaussian.
    pub nearest: &'a Nearest,
    /// Nearest Gaussians of each surfel. They give the surfel its material.
    pub materials: &'a Nearest,
    /// Emitted radiance of each Gaussian.
    pub emission: &'a [[f32; 3]],
}

/// Bytes of the tree of surfels, per surfel.
const TREE_BYTES: u64 = 50;

/// Names of the buffers, in the order of [`TransportShape::each`].
const NAMES: [&str; 19] = [
    "light_records",
    "receiver_unit_light",
    "patch_faces",
    "matrix_rows",
    "matrix_column_starts",
    "matrix_columns",
    "neighbors",
    "neighbor_weights",
    "gather_starts",
    "gather_gaussians",
    "gather_weights",
    "surfel_row_starts",
    "surfel_columns",
    "surfel_weights",
    "surfel_column_starts",
    "surfel_rows",
    "surfel_row_weights",
    "gaussian_emission",
    "split_sum",
];

impl TransportShape {
    /// Returns the bytes of each buffer.
    fn each(&self) -> [u64; NAMES.len()] {
        let MatrixShape { receivers, .. } = self.matrix;
        let words = |count: u32| 4 * u64::from(count.max(1));
        let n = u64::from(self.gaussians.max(1));
        let lights = u64::from(self.lights.max(1));
        let mut table = Graph::new("table");
        let split_sum = split_sum_table(&mut table).1.len() as u64;
        [
            size_of::<LightRecord>() as u64 * lights,
            4 * lights * u64::from(receivers),
            words(receivers - self.surfels),
            self.matrix.bytes(),
            words(receivers + 1),
            words(self.met),
            4 * NEIGHBORS as u64 * n,
            4 * NEIGHBORS as u64 * n,
            words(receivers + 1),
            words(self.gathered),
            words(self.gathered),
            words(self.surfels + 1),
            words(self.described),
            words(self.described),
            4 * (n + 1),
            words(self.described),
            words(self.described),
            16 * n,
            split_sum,
        ]
    }

    /// Returns the bytes of all buffers.
    pub fn bytes(&self) -> u64 {
        self.each().iter().sum::<u64>() + self.scene_bytes
    }

    /// Returns the largest sizes of a room.
    ///
    /// `rays` is their number per receiver.
    pub fn largest(lights: u32, surfels: u32, patches: u32, rays: u32, gaussians: u32) -> TransportShape {
        let receivers = surfels + patches;
        let near = NEIGHBORS as u32;
        TransportShape {
            lights,
            surfels,
            matrix: MatrixShape { receivers, rays },
            met: receivers.saturating_mul(rays),
            gaussians,
            gathered: gaussians.saturating_mul(near),
            described: surfels.saturating_mul(near),
            scene_bytes: TREE_BYTES * u64::from(surfels) + (32 + 4 * u64::from(rays)) * u64::from(receivers),
        }
    }

    /// Returns the bytes of the light of a view with this many pixels.
    pub fn view_bytes(&self, pixels: u64) -> u64 {
        4 * u64::from(self.lights.max(1)) * pixels
    }

    /// Declares the buffers as inputs of a graph.
    pub(in crate::pipeline) fn declare(&self, g: &mut Graph) -> TransportHandles {
        let each = self.each();
        TransportHandles { buffers: std::array::from_fn(|i| g.input(NAMES[i], each[i])) }
    }
}

/// Handles of a [`TransportMemory`] in a graph.
#[derive(Clone, Copy, Debug)]
pub(in crate::pipeline) struct TransportHandles {
    buffers: [Buffer; NAMES.len()],
}

impl TransportHandles {
    pub fn light_records(&self) -> Buffer {
        self.buffers[0]
    }

    pub fn unit(&self) -> Buffer {
        self.buffers[1]
    }

    pub fn faces(&self) -> Buffer {
        self.buffers[2]
    }

    pub fn rows(&self, shape: MatrixShape) -> MatrixRows {
        MatrixRows { shape, rows: self.buffers[3] }
    }

    pub fn columns(&self, shape: MatrixShape) -> MatrixColumns {
        MatrixColumns { shape, starts: self.buffers[4], rows: self.buffers[5] }
    }

    pub fn neighbors(&self) -> [Buffer; 2] {
        [self.buffers[6], self.buffers[7]]
    }

    pub fn gather(&self, receivers: u32) -> GatherColumns {
        let [starts, gaussians, weights] = [8, 9, 10].map(|i| self.buffers[i]);
        GatherColumns { receivers, starts, gaussians, weights }
    }

    /// Returns the weights of the Gaussians in the surfels' materials.
    pub fn surfel_weights(&self) -> Weights {
        let [row_starts, columns, weights, column_starts, rows, row_weights] =
            [11, 12, 13, 14, 15, 16].map(|i| self.buffers[i]);
        Weights { row_starts, columns, weights, column_starts, rows, row_weights, bits: 32 }
    }

    pub fn emission(&self) -> Buffer {
        self.buffers[17]
    }

    pub fn split_sum(&self) -> Buffer {
        self.buffers[18]
    }
}

/// Transport of a room in device memory, as a training step takes it.
#[derive(Debug)]
pub struct TransportMemory {
    shape: TransportShape,
    buffers: Vec<DeviceBuffer>,
}

impl TransportMemory {
    /// Returns the sizes that contents need.
    ///
    /// # Errors
    /// If the device fails.
    pub fn shape_of(scene: &TransportScene, contents: &TransportContents<'_>) -> Result<TransportShape> {
        let matrix = scene.matrix();
        let targets = scene.targets()?;
        let real = |neighbors: &[u32], most: u32| neighbors.iter().filter(|i| **i < most).count() as u32;
        let gaussians = contents.emission.len() as u32;
        Ok(TransportShape {
            lights: contents.lights.len() as u32,
            surfels: contents.surfels,
            matrix,
            met: real(&targets, matrix.receivers).max(1),
            gaussians,
            gathered: real(&contents.nearest.neighbors, matrix.receivers).max(1),
            described: real(&contents.materials.neighbors, gaussians).max(1),
            scene_bytes: scene.bytes(),
        })
    }

    /// Uploads the contents.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn new(device: &Device, scene: &TransportScene, contents: &TransportContents<'_>) -> Result<TransportMemory> {
        let shape = TransportMemory::shape_of(scene, contents)?;
        let receivers = shape.matrix.receivers;
        let mut records: Vec<LightRecord> = contents.lights.iter().map(AreaLight::record).collect();
        records.resize(records.len().max(1), bytemuck::Zeroable::zeroed());
        let columns = transposed(&scene.targets()?, receivers);
        let gather = contents.nearest.columns(receivers);
        let surfels = contents.materials.columns(shape.gaussians);
        // Rows without absent neighbors.
        let (mut starts, mut of_rows, mut weights) = (vec![0_u32], Vec::new(), Vec::new());
        for (row, share) in
            contents.materials.neighbors.chunks(NEIGHBORS).zip(contents.materials.weights.chunks(NEIGHBORS))
        {
            for (gaussian, weight) in row.iter().zip(share).filter(|(gaussian, _)| **gaussian < shape.gaussians) {
                of_rows.push(*gaussian);
                weights.push(*weight);
            }
            starts.push(of_rows.len() as u32);
        }
        let emission: Vec<f32> = contents.emission.iter().flat_map(|[r, g, b]| [*r, *g, *b, 0.0]).collect();
        let unit = scene.unit_light(contents.lights)?;
        let mut table = Graph::new("table");
        let (_, split_sum) = split_sum_table(&mut table);
        let words = |values: &[u32]| bytemuck::cast_slice::<u32, u8>(values).to_vec();
        let floats = |values: &[f32]| bytemuck::cast_slice::<f32, u8>(values).to_vec();
        let each: [Vec<u8>; NAMES.len()] = [
            bytemuck::cast_slice(&records).to_vec(),
            floats(&unit),
            words(contents.faces),
            Vec::new(),
            words(&columns.starts),
            words(&columns.rows),
            words(&contents.nearest.neighbors),
            floats(&contents.nearest.weights),
            words(&gather.starts),
            words(&gather.gaussians),
            floats(&gather.weights),
            words(&starts),
            words(&of_rows),
            floats(&weights),
            words(&surfels.starts),
            words(&surfels.gaussians),
            floats(&surfels.weights),
            floats(&emission),
            split_sum,
        ];
        let mut buffers = Vec::new();
        for ((name, bytes), contents) in NAMES.iter().zip(shape.each()).zip(&each) {
            if *name == "matrix_rows" {
                buffers.push(scene.matrix_rows().clone());
                continue;
            }
            let buffer = device.buffer(name, bytes, Location::Device)?;
            device.fill(&buffer, 0)?;
            if !contents.is_empty() {
                device.upload(&buffer, 0, contents)?;
            }
            buffers.push(buffer);
        }
        Ok(TransportMemory { shape, buffers })
    }

    /// Allocates buffers without contents, to plan a training.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn empty(device: &Device, shape: TransportShape) -> Result<TransportMemory> {
        let each = NAMES.iter().zip(shape.each());
        let buffers = each.map(|(name, bytes)| device.buffer(name, bytes, Location::Device)).collect::<Result<_>>()?;
        Ok(TransportMemory { shape, buffers })
    }

    /// Returns the sizes.
    pub fn shape(&self) -> &TransportShape {
        &self.shape
    }

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was compiled for other sizes.
    pub(in crate::pipeline) fn bind(&self, exec: &mut Executor, handles: &TransportHandles) -> Result<()> {
        handles.buffers.iter().zip(&self.buffers).try_for_each(|(handle, buffer)| exec.bind(*handle, buffer))
    }
}

/// Irradiance of the pixels of views from each light of color 1.
pub struct ViewLights {
    device: Device,
    exec: Executor,
    step: Buffer,
    surface: SurfaceHandles,
    unit: Buffer,
    bytes: u64,
    tile: [u32; 2],
}

impl ViewLights {
    /// Compiles the passes for views of this shape.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        scene: &TransportScene,
        lights: &[AreaLight],
        shape: &SurfaceShape,
    ) -> Result<ViewLights> {
        let t = scene.tuning();
        let mut g = Graph::new("view_lights");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let surface = shape.declare(&mut g, "", false);
        let screen = Screen { step, largest: shape.largest, tile: t.tile };
        let tree = SurfelHandles::declare(&mut g, scene.tree_shape());
        let outside = OutsideHandles::declare(&mut g, scene.outside_shape());
        let of_lights = AreaLights::declare(&mut g, lights.len() as u32);
        let bytes = 4 * screen.pixels() * lights.len().max(1) as u64;
        let unit = g.external("unit_light", bytes);
        g.fill("clear_unit_light", unit, 0)?;
        let to = LightReceivers::Pixels { screen, surfaces: surface.surfaces };
        transport_lights(&mut g, *t, &to, &of_lights, &scene.shadow_rays(tree, outside), None, unit)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        scene.tree().bind(&mut exec, &tree)?;
        scene.outside().bind(&mut exec, &outside)?;
        for (handle, contents) in of_lights.contents(lights) {
            let buffer = device.buffer("lights", contents.len() as u64, Location::Device)?;
            device.upload(&buffer, 0, &contents)?;
            exec.bind(handle, &buffer)?;
        }
        Ok(ViewLights { device: device.clone(), exec, step, surface, unit, bytes, tile: t.tile })
    }

    /// Allocates the light of a view.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn allocate(&self) -> Result<DeviceBuffer> {
        self.device.buffer("view_light", self.bytes, Location::Device)
    }

    /// Computes the light of a view, without waiting for it. The camera is in the unit of the scene.
    ///
    /// Waits for the view before.
    ///
    /// # Errors
    /// If the device fails.
    pub fn fill(&mut self, surface: &Surface, camera: &Camera, into: &DeviceBuffer) -> Result<()> {
        surface.bind(&mut self.exec, &self.surface)?;
        self.exec.bind(self.unit, into)?;
        let mut step = Step { camera: *camera, ..Step::default() };
        let size = camera.size;
        step.camera.tiles = [size[0].div_ceil(self.tile[0]), size[1].div_ceil(self.tile[1])];
        self.exec.submit(&[(self.step, bytemuck::bytes_of(&step))])?;
        Ok(())
    }

    /// Waits for the submitted work.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> Result<()> {
        self.exec.finish()
    }
}

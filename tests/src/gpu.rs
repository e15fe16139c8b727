//! Device for tests: validation on, outputs poisoned; any message fails the test.

use crate::emulated::Emulated;
use crate::pool::{self, finished, leftovers};
use crate::turn::{Share, Turn, turn};
use sgs_emulator::Schedule;
use sgs_engine::device::PipelineInfo;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, BufferKind, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::Tuning;
use std::sync::Arc;

/// Device whose drop fails the test after a validation message.
///
/// The drop also fails if an object outlives the device, or a pipeline relies on a subgroup size.
pub struct Gpu {
    /// Present until the drop.
    device: Option<Device>,
    /// Present if the emulator runs the graphs.
    emulated: Option<Emulated>,
    /// Replaces the numbers of the tuning.
    large_tiles: Option<u32>,
    slots: Option<(bool, u32, f32)>,
    tile_parts: Option<u32>,
    // Last field, so that others wait until the device is closed or back in the pool.
    right: Right,
}

/// Right to use the device, which tells where the device goes.
enum Right {
    /// Back into the pool, after `tests` earlier tests.
    Pool { tests: u32, _share: Share },
    /// Closed.
    Own { _turn: Turn },
}

/// Contents of the external buffers after a graph ran.
pub struct Outputs {
    contents: Vec<Vec<u8>>,
}

impl Outputs {
    /// Returns the contents of an external buffer as values.
    pub fn get<T: bytemuck::Pod>(&self, buffer: Buffer) -> Vec<T> {
        let bytes = &self.contents[buffer.index()];
        let count = bytes.len() / size_of::<T>();
        let mut values = vec![T::zeroed(); count];
        bytemuck::cast_slice_mut(&mut values).copy_from_slice(&bytes[..count * size_of::<T>()]);
        values
    }
}

impl Default for Gpu {
    fn default() -> Self {
        Gpu::new()
    }
}

impl Gpu {
    /// Takes a device with validation from the pool of this process.
    ///
    /// It is the one that `SGS_TEST_DEVICE` names, or the best one. Pipelines of earlier tests are still in it. A
    /// thread has at most one such device at a time.
    pub fn new() -> Gpu {
        let ((device, tests), share) = pool::take();
        let right = Right::Pool { tests, _share: share };
        let emulated = Emulated::wanted();
        Gpu { device: Some(device), emulated, large_tiles: None, slots: None, tile_parts: None, right }
    }

    /// Opens a device of its own, without pipelines and with a peak of memory of zero.
    ///
    /// Waits until no other test uses a device with validation, and keeps others from it ([`turn()`]).
    pub fn fresh() -> Gpu {
        let turn = turn();
        let right = Right::Own { _turn: turn };
        let (device, emulated) = (Some(pool::open()), Emulated::wanted());
        Gpu { device, emulated, large_tiles: None, slots: None, tile_parts: None, right }
    }

    /// Returns the same device with another [`Tuning::large_tiles`].
    ///
    /// With 0 the lanes process every splat together.
    pub fn with_large_tiles(mut self, tiles: u32) -> Gpu {
        self.large_tiles = Some(tiles);
        self
    }

    /// Returns the same device with other slots ([`Tuning::sub_tiles`]).
    ///
    /// `margin` is [`Tuning::slot_margin`].
    pub fn with_slots(mut self, sub_tiles: bool, width: u32, margin: f32) -> Gpu {
        self.slots = Some((sub_tiles, width, margin));
        self
    }

    /// Returns the same device with another [`Tuning::tile_parts`].
    pub fn with_tile_parts(mut self, parts: u32) -> Gpu {
        self.tile_parts = Some(parts);
        self
    }

    /// Returns the device.
    pub fn device(&self) -> &Device {
        self.device.as_ref().expect("the device is present until the drop")
    }

    /// Returns kernel sizes for the device.
    pub fn tuning(&self) -> Tuning {
        let (info, lanes) = (self.device().info(), self.subgroup_size());
        let other = lanes != info.subgroup_size;
        let tuning = if other { Tuning::for_subgroups(lanes) } else { Tuning::for_device(info) };
        let own = (tuning.sub_tiles, tuning.slot_width, tuning.slot_margin);
        let (sub_tiles, slot_width, slot_margin) = self.slots.unwrap_or(own);
        let large_tiles = self.large_tiles.unwrap_or(tuning.large_tiles);
        let tile_parts = self.tile_parts.or(tuning.tile_parts);
        Tuning { large_tiles, sub_tiles, slot_width, slot_margin, tile_parts, ..tuning }
    }

    /// Returns how far the device may round a division, in units of exact rounding.
    ///
    /// Vulkan allows 2.5 units in the last place instead of half a unit (Precision of core SPIR-V instructions). Processors
    /// round exactly.
    pub fn division_error(&self) -> f64 {
        if self.device().info().kind == "cpu" { 1.0 } else { 5.0 }
    }

    /// Returns the subgroup size of the device, or of the emulator in its place.
    pub fn subgroup_size(&self) -> u32 {
        self.emulated.as_ref().map_or(self.device().info().subgroup_size, Emulated::lanes)
    }

    /// Runs `f` with this device while the emulator runs its graphs.
    ///
    /// The emulator has the subgroup size of the device.
    pub fn emulating<T>(&mut self, schedule: Schedule, f: impl FnOnce(&Gpu) -> T) -> T {
        self.emulating_lanes(self.subgroup_size(), schedule, f)
    }

    /// Runs `f` like [`Gpu::emulating`], with any subgroup size.
    ///
    /// At another size than that of the device, kernels have the tuning of a GPU.
    pub fn emulating_lanes<T>(&mut self, lanes: u32, schedule: Schedule, f: impl FnOnce(&Gpu) -> T) -> T {
        let before = self.emulated.replace(Emulated::new(lanes, schedule));
        let result = f(self);
        self.emulated = before;
        result
    }

    /// Runs a graph once.
    ///
    /// External buffers and uniforms in `inputs` start with that content. Other external buffers and all transients
    /// start with ones in every bit (NaN as a float).
    pub fn run(&self, graph: Graph, inputs: &[(Buffer, Vec<u8>)]) -> Outputs {
        self.run_times(graph, inputs, 1)
    }

    /// Runs a graph like [`Gpu::run`], with several replays in sequence.
    pub fn run_times(&self, graph: Graph, inputs: &[(Buffer, Vec<u8>)], replays: usize) -> Outputs {
        let plan = Arc::new(graph.compile(&CompileOptions::default()).unwrap_or_else(|e| panic!("{e}")));
        if let Some(emulated) = &self.emulated {
            return Outputs { contents: emulated.run(&plan, inputs, replays) };
        }
        let options = ExecOptions { poison: true, ..Default::default() };
        let mut exec = Executor::new(self.device(), plan.clone(), options).unwrap_or_else(|e| panic!("{e}"));
        let provided = |i: usize| inputs.iter().find(|(b, _)| b.index() == i).map(|(_, d)| d.as_slice());
        let mut memory: Vec<Option<DeviceBuffer>> = Vec::new();
        for (i, info) in plan.buffers.iter().enumerate() {
            if info.kind != BufferKind::External {
                memory.push(None);
                continue;
            }
            let buffer = self.device().buffer(&info.name, info.bytes, Location::Device).unwrap();
            self.device().fill(&buffer, u32::MAX).unwrap();
            if let Some(data) = provided(i) {
                assert!(data.len() as u64 <= info.bytes, "\"{}\" is given more than it holds", info.name);
                self.device().upload(&buffer, 0, data).unwrap();
            }
            memory.push(Some(buffer));
        }
        // Only the graph makes handles. Uniforms use the handles in `inputs`; external buffers are bound through the
        // plan's own numbering.
        for (i, buffer) in memory.iter().enumerate() {
            if let Some(buffer) = buffer {
                exec.bind(plan.buffer(i), buffer).unwrap();
            }
        }
        let uniforms: Vec<(Buffer, &[u8])> = inputs
            .iter()
            .filter(|(b, _)| plan.buffers[b.index()].kind == BufferKind::Uniform)
            .map(|(b, d)| (*b, d.as_slice()))
            .collect();
        for _ in 0..replays {
            exec.submit(&uniforms).unwrap_or_else(|e| panic!("{e}"));
        }
        exec.finish().unwrap_or_else(|e| panic!("{e}"));
        let contents = memory
            .iter()
            .map(|m| m.as_ref().map_or_else(Vec::new, |b| self.device().download(b, 0, b.bytes()).unwrap()))
            .collect();
        Outputs { contents }
    }
}

/// Returns pipelines that rely on a subgroup size that the device may not use.
///
/// Such a pipeline could run at another subgroup size than its specialization constant, or with inactive lanes.
pub fn subgroup_faults(device: &Device) -> Vec<String> {
    let info = device.info();
    let fixed = info.subgroup_sizes.0 == info.subgroup_sizes.1;
    let fault = |p: &PipelineInfo| {
        let constant = p.specs.iter().find(|(name, _)| name == "SUBGROUP").map_or(p.subgroup_size, |(_, bits)| *bits);
        // These kernels multiply matrices of any size with ordinary instructions, without subgroup operations.
        let emulated = p.kernel.ends_with("_halves");
        let wrong = p.uses_subgroups && constant != p.subgroup_size && !emulated;
        let partial = p.uses_subgroups && info.optional.full_subgroups && !p.full_subgroups && !emulated;
        (wrong || partial || !(p.requested || fixed)).then(|| format!("{p:?}"))
    };
    device.pipelines().iter().filter_map(fault).collect()
}

impl Drop for Gpu {
    fn drop(&mut self) {
        let Some(device) = self.device.take() else { return };
        let faults = subgroup_faults(&device);
        let log = device.messages().clone();
        // Messages are taken in any case, and before another test has the device.
        let (messages, objects) = match self.right {
            Right::Pool { tests, .. } => {
                let finished = finished(&device);
                let (messages, objects) = (log.take(), leftovers(&device));
                pool::put((device, tests + 1), !finished || !objects.is_empty() || !faults.is_empty());
                (messages, objects)
            }
            Right::Own { .. } => {
                let objects = device.objects().clone();
                drop(device);
                (log.take(), objects.alive())
            }
        };
        if std::thread::panicking() {
            return;
        }
        assert!(faults.is_empty(), "pipelines that rely on a subgroup size:\n{}", faults.join("\n"));
        assert!(messages.is_empty(), "validation reported {} messages:\n{}", messages.len(), messages.join("\n"));
        assert!(objects.is_empty(), "objects outlive the device of the test: {objects:?}");
    }
}

//! Runs compiled graphs.

use crate::exec::encode;
use crate::fault::Fault;
use crate::memory::{Binding, Store};
use crate::random::Random;
use crate::{Dispatch, Kernel, LIMIT, Schedule};
use sgs_engine::ImageFormat;
use sgs_engine::graph::{BufferKind, Dispatch as Groups, Image, PassKind, Plan, Slice};
use sgs_engine::shader::Shader;
use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

/// Kernel, specialization constants and lanes.
type Key = (Arc<Shader>, Vec<(u32, u32)>, u32);

/// Device that runs compiled graphs on byte arrays.
#[derive(Default)]
pub struct Emulator {
    kernels: Mutex<HashMap<Key, Arc<Kernel>>>,
    ran: Mutex<BTreeSet<(String, u32)>>,
}

/// How a plan runs.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Lanes of passes that request no subgroup size.
    pub lanes: u32,
    /// Order of execution. It also orders the passes of a group.
    pub schedule: Schedule,
    /// Number of replays.
    pub replays: usize,
    /// Races on buffers that are no faults: kernel and buffer.
    pub tolerated: &'static [(&'static str, &'static str)],
}

/// Memory of a plan: the arena, then one for each external buffer and uniform.
struct Memory {
    stores: Vec<Store>,
    /// By buffer: memory and first byte.
    places: Vec<(usize, u64)>,
    /// By buffer: size and format of an image.
    images: Vec<Option<([u32; 2], ImageFormat)>>,
}

impl Memory {
    /// Creates memory with ones in every bit, except for inputs.
    fn new(plan: &Plan, inputs: &[(usize, &[u8])]) -> Memory {
        let ones = |bytes: u64| Store::new(vec![u32::MAX; bytes.div_ceil(4) as usize]);
        let images = plan.buffers.iter().map(|info| info.image.map(|image| (image.size, image.format))).collect();
        let mut memory = Memory { stores: vec![ones(plan.arena_bytes)], places: Vec::new(), images };
        for (index, info) in plan.buffers.iter().enumerate() {
            // Each image has memory of its own, although images share some on a device.
            if info.kind == BufferKind::Transient && info.image.is_none() {
                memory.places.push((0, plan.placements[index].unwrap_or(0)));
                continue;
            }
            let mut store = ones(info.bytes);
            if let Some((_, content)) = inputs.iter().find(|(i, _)| *i == index) {
                let content = Store::from_bytes(content);
                store.words_mut()[..content.words().len()].copy_from_slice(content.words());
            }
            memory.places.push((memory.stores.len(), 0));
            memory.stores.push(store);
        }
        memory
    }

    fn binding(&self, number: u32, slice: &Slice) -> Binding {
        let (store, base) = self.places[slice.buffer.index()];
        let image = self.images[slice.buffer.index()];
        Binding { number, store, offset: base + slice.offset, bytes: slice.bytes, image }
    }

    /// Returns the words of an image.
    fn image(&mut self, image: Image) -> &mut [u32] {
        let (store, _) = self.places[image.index()];
        self.stores[store].words_mut()
    }

    /// Returns the words of a slice.
    fn words(&mut self, slice: &Slice) -> &mut [u32] {
        let Binding { store, offset, bytes, .. } = self.binding(0, slice);
        &mut self.stores[store].words_mut()[(offset / 4) as usize..((offset + bytes) / 4) as usize]
    }
}

impl Emulator {
    /// Returns the kernels that ran, with their lanes.
    pub fn ran(&self) -> Vec<(String, u32)> {
        self.ran.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }

    /// Runs a plan. Returns the contents of each buffer; empty for transients.
    ///
    /// `inputs` are contents by buffer index. All other memory starts with ones in every bit.
    ///
    /// # Errors
    /// The first fault of a kernel, or an operation on images.
    pub fn run(&self, plan: &Plan, inputs: &[(usize, &[u8])], run: Run) -> Result<Vec<Vec<u8>>, Fault> {
        let mut memory = Memory::new(plan, inputs);
        let mut random = Random::new(run.schedule.seed());
        let mut stamp = 0;
        for _ in 0..run.replays {
            memory.stores[0].words_mut().fill(u32::MAX);
            for group in &plan.groups {
                let mut passes = group.passes.clone();
                match run.schedule {
                    Schedule::Ascending => {}
                    Schedule::Descending => passes.reverse(),
                    Schedule::Shuffled(_) => random.shuffle(&mut passes),
                }
                for pass in passes {
                    let pass = &plan.passes[pass];
                    stamp += 1;
                    self.pass(&pass.kind, &mut memory, run, stamp)
                        .map_err(|f| f.within(&format!("pass {} at {} lanes", pass.name, run.lanes)))?;
                }
            }
        }
        let content = |(index, info): (usize, &sgs_engine::graph::BufferInfo)| {
            let (store, _) = memory.places[index];
            let bytes = if info.kind == BufferKind::External { memory.stores[store].bytes() } else { Vec::new() };
            bytes[..bytes.len().min(info.bytes as usize)].to_vec()
        };
        Ok(plan.buffers.iter().enumerate().map(content).collect())
    }

    fn pass(&self, kind: &PassKind, memory: &mut Memory, run: Run, stamp: u32) -> Result<(), Fault> {
        match kind {
            PassKind::Compute { shader, specs, push, bindings, subgroup_size, dispatch } => {
                let lanes = subgroup_size.unwrap_or(run.lanes);
                let groups = match dispatch {
                    Groups::Groups(groups) => *groups,
                    Groups::Indirect { buffer, offset } => {
                        let words = memory.words(&buffer.slice(*offset, 12));
                        [words[0], words[1], words[2]]
                    }
                };
                let kernel = self.kernel(shader, specs, lanes).map_err(|f| f.within(&shader.name))?;
                let bindings: Vec<Binding> = bindings.iter().map(|(n, slice)| memory.binding(*n, slice)).collect();
                let tolerated: Vec<&str> =
                    run.tolerated.iter().filter(|(kernel, _)| *kernel == shader.name).map(|(_, b)| *b).collect();
                let (schedule, tolerated) = (run.schedule, &tolerated[..]);
                let dispatch = Dispatch { lanes, groups, bindings: &bindings, push, schedule, tolerated, limit: LIMIT };
                kernel.run(&mut memory.stores, &dispatch, stamp).map_err(|f| f.within(&shader.name))?;
                let mut ran = self.ran.lock().unwrap_or_else(PoisonError::into_inner);
                ran.insert((shader.name.to_string(), lanes));
            }
            PassKind::Fill { target, value } => memory.words(target).fill(*value),
            PassKind::Copy { source, target } => {
                let words = memory.words(source).to_vec();
                memory.words(target).copy_from_slice(&words);
            }
            PassKind::CopyToImage { source, target } => {
                let words = memory.words(source).to_vec();
                memory.image(*target).copy_from_slice(&words);
            }
            PassKind::CopyFromImage { source, target } => {
                let words = memory.image(*source).to_vec();
                memory.words(target).copy_from_slice(&words);
            }
            PassKind::ClearImage { target, value } => {
                if let Some((_, format)) = memory.images[target.index()] {
                    let texel = encode(format, *value)?;
                    memory.image(*target).chunks_mut(texel.len()).for_each(|t| t.copy_from_slice(&texel));
                }
            }
        }
        Ok(())
    }

    /// Returns the translated kernel.
    fn kernel(&self, shader: &Arc<Shader>, specs: &[(u32, u32)], lanes: u32) -> Result<Arc<Kernel>, Fault> {
        let mut kernels = self.kernels.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (shader.clone(), specs.to_vec(), lanes);
        if let Some(kernel) = kernels.get(&key) {
            return Ok(kernel.clone());
        }
        let kernel = Arc::new(Kernel::for_lanes(&shader.spirv, specs, lanes)?);
        kernels.insert(key, kernel.clone());
        Ok(kernel)
    }
}

//! Runs plans: binds memory, records one command buffer a frame in flight, replays it.
//!
//! Promises: once every slot is recorded, a replay waits only for its own slot, copies the uniforms, and submits;
//! nothing is allocated or recorded. Work of different executors on one device is ordered by submission. Leaves hazards
//! inside a replay to the plan.

mod bind;
mod external;
mod history;
mod lanes;
mod record;
mod time;

pub use external::{Recorded, SemaphorePoint, Until};
pub use time::PassTime;

use super::{Buffer, BufferKind, Image, Plan, Switch, Use};
use crate::device::{Device, ObjectKind, Parked, Ticket};
use crate::error::{Error, Result};
use crate::memory::{DeviceBuffer, DeviceImage, Location};
use ash::vk;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How a plan is run.
#[derive(Clone, Debug)]
pub struct ExecOptions {
    /// Replays that may be in flight together; uniforms have one slot each.
    pub frames_in_flight: usize,
    /// Two timestamps around every pass.
    pub timestamps: bool,
    /// Fill the arena with ones before each replay, so that reading what nobody wrote shows.
    pub poison: bool,
    /// Memory for the transients, shared with other executors of the device; own memory if absent or too small.
    pub arena: Option<DeviceBuffer>,
}

impl Default for ExecOptions {
    fn default() -> Self {
        ExecOptions { frames_in_flight: 2, timestamps: false, poison: false, arena: None }
    }
}

/// A plan with its memory, ready to be replayed.
pub struct Executor {
    device: Device,
    plan: Arc<Plan>,
    options: ExecOptions,
    /// By buffer; uniforms and transients stay empty.
    externals: Vec<Option<DeviceBuffer>>,
    /// By buffer; only external images have one.
    images: Vec<Option<DeviceImage>>,
    /// The plan's image slots.
    slot_images: Vec<DeviceImage>,
    arena: Option<DeviceBuffer>,
    /// Byte offset of each uniform inside a slot's uniform memory.
    uniform_offsets: Vec<u64>,
    /// The switches and what they are set to.
    switches: Vec<(Buffer, u32)>,
    slots: Vec<Slot>,
    side: Option<lanes::Side>,
    next: usize,
    uniform_bytes: u64,
    /// What is recorded into command buffers of a host.
    lent: Vec<external::Lent>,
    times: time::Times,
    host: HostTimes,
    /// A wait has failed: what is in flight is not waited for again, only left until it is done.
    gave_up: bool,
}

/// What replaying has cost the host since the executor was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HostTimes {
    /// Replays submitted.
    pub replays: u64,
    /// Of these, the ones that had to be recorded first.
    pub recorded: u64,
    /// Spent in [`Executor::submit`], waiting excluded: uniforms, recording, the submission itself.
    pub working: Duration,
    /// Of this, spent inside `vkQueueSubmit2`: the driver's.
    pub submitting: Duration,
    /// Spent waiting for the device, in [`Executor::submit`] and [`Executor::finish`].
    pub waiting: Duration,
}

impl HostTimes {
    /// Since an earlier look: seconds of a replay besides its submission, and of its submission; zero without replays.
    pub fn since(&self, earlier: &HostTimes) -> (f64, f64) {
        let replays = (self.replays - earlier.replays).max(1) as f64;
        let submitting = (self.submitting - earlier.submitting).as_secs_f64();
        let working = (self.working - earlier.working).as_secs_f64();
        ((working - submitting).max(0.0) / replays, submitting / replays)
    }
}

/// What one replay in flight owns.
struct Slot {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    descriptors: vk::DescriptorPool,
    queries: vk::QueryPool,
    uniforms: Option<DeviceBuffer>,
    recorded: bool,
    /// Whether the halves of histories have changed places in its replays: in every other slot, and there is an even
    /// number of them, so that nothing is recorded again.
    swapped: bool,
    /// For plans of more than one segment.
    segments: Option<lanes::Segments>,
    ticket: Option<Ticket>,
}

impl Executor {
    /// Prepares a plan: its arena and the slots.
    ///
    /// # Errors
    /// If memory runs out, or the plan exceeds the device's limits ([`DeviceInfo::check_plan`](crate::DeviceInfo::check_plan)).
    pub fn new(device: &Device, plan: Arc<Plan>, options: ExecOptions) -> Result<Executor> {
        device.info().check_plan(&plan)?;
        let arena = match (&options.arena, plan.arena_bytes) {
            (_, 0) => None,
            (Some(shared), bytes) if shared.bytes() >= bytes => Some(shared.clone()),
            (_, bytes) => Some(device.buffer(&format!("arena of {}", plan.name), bytes, Location::Device)?),
        };
        let mut uniform_bytes = 0;
        let uniform_offsets = plan
            .buffers
            .iter()
            .map(|b| {
                let at = uniform_bytes;
                if b.kind == BufferKind::Uniform {
                    uniform_bytes += {
                        // Kernels may bind it as a storage buffer too.
                        let info = device.info();
                        b.bytes.next_multiple_of(info.uniform_alignment.max(info.storage_alignment).max(16))
                    };
                }
                at
            })
            .collect();
        let mut executor = Executor {
            device: device.clone(),
            externals: vec![None; plan.buffers.len()],
            images: vec![None; plan.buffers.len()],
            slot_images: Vec::new(),
            arena,
            uniform_offsets,
            switches: plan.buffers().filter(|(_, info)| info.switch).map(|(buffer, _)| (buffer, 1)).collect(),
            slots: Vec::new(),
            side: None,
            next: 0,
            uniform_bytes,
            lent: Vec::new(),
            times: time::Times::new(&plan, options.timestamps && device.info().timestamp_period > 0.0),
            host: HostTimes::default(),
            gave_up: false,
            plan,
            options,
        };
        for (number, slot) in executor.plan.image_slots.iter().enumerate() {
            let name = format!("image {number} of {}", executor.plan.name);
            executor.slot_images.push(device.image(&name, slot.size, slot.format)?);
        }
        executor.make_histories()?;
        executor.make_side()?;
        let frames = executor.frames();
        let slots = if executor.has_histories() { frames.next_multiple_of(2) } else { frames };
        for _ in 0..slots {
            let slot = executor.slot()?;
            executor.slots.push(slot);
        }
        Ok(executor)
    }

    /// Replays that may be in flight together.
    fn frames(&self) -> usize {
        self.options.frames_in_flight.max(1)
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<Plan> {
        &self.plan
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The arena's memory, for sharing with other executors.
    pub fn arena(&self) -> Option<&DeviceBuffer> {
        self.arena.as_ref()
    }

    /// Puts memory behind an external buffer of the plan. Before the first replay this is free; later it waits for
    /// the replays in flight and records again.
    ///
    /// # Errors
    /// If the memory is smaller than declared.
    pub fn bind(&mut self, buffer: Buffer, memory: &DeviceBuffer) -> Result<()> {
        memory.check_range(0, self.plan.buffers[buffer.index()].bytes)?;
        let place = &mut self.externals[buffer.index()];
        if place.as_ref().is_some_and(|old| Arc::ptr_eq(&old.0, &memory.0)) {
            return Ok(());
        }
        if place.is_some() {
            self.finish()?;
        }
        self.externals[buffer.index()] = Some(memory.clone());
        for slot in &mut self.slots {
            slot.recorded = false;
        }
        Ok(())
    }

    /// Puts an image behind an external image of the plan; as [`Executor::bind`].
    ///
    /// # Errors
    /// [`Error::WrongImage`] if it is of another size or format than declared; [`Error::NotStorageImage`] if a kernel is to
    /// read or write it and cannot.
    pub fn bind_image(&mut self, image: Image, memory: &DeviceImage) -> Result<()> {
        let info = &self.plan.buffers[image.index()];
        let shape = |[width, height]: [u32; 2], format| format!("{width}x{height} {format}");
        let given = shape(memory.size(), memory.format());
        let declared = info.image.map_or("a buffer".to_owned(), |image| shape(image.size, image.format));
        if declared != given {
            return Err(Error::WrongImage { image: info.name.clone(), given, declared });
        }
        let in_kernels = self.plan.passes.iter().flat_map(|pass| &pass.accesses);
        let mut in_kernels = in_kernels.filter(|(_, _, used)| *used == Use::Compute).map(|(slice, ..)| slice.buffer);
        if !memory.storage() && in_kernels.any(|buffer| buffer == image.0) {
            return Err(Error::NotStorageImage { image: memory.name().to_owned(), format: memory.format() });
        }
        let place = &self.images[image.index()];
        if place.as_ref().is_some_and(|old| Arc::ptr_eq(&old.0, &memory.0)) {
            return Ok(());
        }
        if place.is_some() {
            self.finish()?;
        }
        self.images[image.index()] = Some(memory.clone());
        for slot in &mut self.slots {
            slot.recorded = false;
        }
        Ok(())
    }

    /// Turns a switch on or off, for the replays submitted from now on.
    pub fn set_switch(&mut self, switch: Switch, on: bool) {
        if let Some((_, word)) = self.switches.iter_mut().find(|(buffer, _)| *buffer == switch.0) {
            *word = u32::from(on);
        }
    }

    /// Replays the plan with these uniforms; returns where on the timeline it ends.
    ///
    /// # Errors
    /// If an external buffer is not bound, or the device fails.
    pub fn submit(&mut self, uniforms: &[(Buffer, &[u8])]) -> Result<Ticket> {
        self.submit_between(uniforms, &[], &[])
    }

    fn submit_between(
        &mut self,
        uniforms: &[(Buffer, &[u8])],
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        signals: &[vk::SemaphoreSubmitInfo<'_>],
    ) -> Result<Ticket> {
        let begin = Instant::now();
        let index = self.next;
        let mut waited = self.retire(index, self.device.timeout())?;
        // There may be one slot more than replays may be in flight.
        let frames = self.frames();
        if frames < self.slots.len() {
            let oldest = (index + self.slots.len() - frames) % self.slots.len();
            waited += self.retire(oldest, self.device.timeout())?;
        }
        self.write_uniforms(&self.slots[index], uniforms)?;
        if !self.slots[index].recorded {
            self.record(index)?;
            self.host.recorded += 1;
        }
        let handed = Instant::now();
        let ticket = self.submit_segments(index, waits, signals)?;
        self.host.submitting += handed.elapsed();
        self.slots[index].ticket = Some(ticket);
        self.next = (index + 1) % self.slots.len();
        self.host.replays += 1;
        self.host.working += begin.elapsed().saturating_sub(waited);
        Ok(ticket)
    }

    fn write_uniforms(&self, slot: &Slot, uniforms: &[(Buffer, &[u8])]) -> Result<()> {
        let Some(memory) = &slot.uniforms else { return Ok(()) };
        for (buffer, word) in &self.switches {
            memory.write(self.uniform_offsets[buffer.index()], &word.to_ne_bytes())?;
        }
        for (buffer, data) in uniforms {
            memory.write(self.uniform_offsets[buffer.index()], data)?;
        }
        Ok(())
    }

    /// Waits for every replay in flight.
    ///
    /// # Errors
    /// [`Error::Timeout`], [`Error::DeviceLost`].
    pub fn finish(&mut self) -> Result<()> {
        self.finish_within(self.device.timeout())
    }

    /// As [`Executor::finish`], with a time limit of its own for each replay. After a timeout it may be called again.
    ///
    /// # Errors
    /// [`Error::Timeout`] with the pass that has not ended, where there are timestamps; [`Error::DeviceLost`].
    pub fn finish_within(&mut self, limit: Duration) -> Result<()> {
        for i in 0..self.slots.len() {
            self.retire((self.next + i) % self.slots.len(), limit)?;
        }
        Ok(())
    }

    /// Waits for the replay in a slot, if there is one, and takes its times; returns how long it waited.
    fn retire(&mut self, index: usize, limit: Duration) -> Result<Duration> {
        let Some(ticket) = self.slots[index].ticket else { return Ok(Duration::ZERO) };
        let begin = Instant::now();
        if let Err(mut error) = self.device.wait_within(ticket, &self.plan.name, limit) {
            self.gave_up = true;
            if let Error::Timeout { pass, .. } = &mut error {
                *pass = self.times.running(&self.device, self.slots[index].queries);
            }
            return Err(error);
        }
        self.slots[index].ticket = None;
        let waited = begin.elapsed();
        self.host.waiting += waited;
        self.times.collect(&self.device, self.slots[index].queries)?;
        Ok(waited)
    }

    /// What replaying has cost the host so far.
    pub fn host_times(&self) -> HostTimes {
        self.host
    }

    /// Nanoseconds of each pass in the replays whose end was seen since the last call (empty without timestamps).
    pub fn take_times(&mut self) -> Vec<PassTime> {
        self.times.take()
    }

    fn slot_uniforms(&self) -> Result<Option<DeviceBuffer>> {
        if self.uniform_bytes == 0 {
            return Ok(None);
        }
        let name = format!("uniforms of {}", self.plan.name);
        self.device.buffer(&name, self.uniform_bytes, Location::Upload).map(Some)
    }

    fn slot(&self) -> Result<Slot> {
        let shared = &self.device.0;
        let name = &self.plan.name;
        let uniforms = self.slot_uniforms()?;
        let pool_info = vk::CommandPoolCreateInfo::default().queue_family_index(shared.queue_family);
        // SAFETY: the device is alive.
        let pool = shared.gate.make(ObjectKind::CommandPool, "vkCreateCommandPool", name, || unsafe {
            shared.raw.create_command_pool(&pool_info, None)
        })?;
        let mut slot = Slot {
            pool,
            commands: vk::CommandBuffer::null(),
            descriptors: vk::DescriptorPool::null(),
            queries: vk::QueryPool::null(),
            uniforms,
            recorded: false,
            swapped: !self.slots.len().is_multiple_of(2),
            segments: None,
            ticket: None,
        };
        if let Err(error) = self.fill_slot(&mut slot) {
            self.destroy_slot(&slot, Ticket(0));
            return Err(error);
        }
        Ok(slot)
    }

    fn fill_slot(&self, slot: &mut Slot) -> Result<()> {
        let shared = &self.device.0;
        let name = &self.plan.name;
        let commands = vk::CommandBufferAllocateInfo::default()
            .command_pool(slot.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        // SAFETY: the pool was made from this device.
        slot.commands = shared
            .gate
            .call("vkAllocateCommandBuffers", name, || unsafe { shared.raw.allocate_command_buffers(&commands) })?[0];
        shared.name(slot.commands, name);
        self.make_segments(slot)?;
        slot.descriptors = self.descriptor_pool()?;
        if self.times.enabled() {
            let info = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(2 * self.plan.passes.len() as u32);
            // SAFETY: the device is alive.
            slot.queries = shared.gate.make(ObjectKind::QueryPool, "vkCreateQueryPool", name, || unsafe {
                shared.raw.create_query_pool(&info, None)
            })?;
            // Stamps are also looked at before the first replay has reset them.
            // SAFETY: the pool was just made with that many queries; host resets are a required feature.
            unsafe { shared.raw.reset_query_pool(slot.queries, 0, 2 * self.plan.passes.len() as u32) };
        }
        Ok(())
    }

    /// Destroys what a slot owns, once the timeline has passed `until`.
    fn destroy_slot(&self, slot: &Slot, until: Ticket) {
        let shared = &self.device.0;
        if slot.queries != vk::QueryPool::null() {
            shared.dispose(until, Parked::QueryPool(slot.queries));
        }
        if slot.descriptors != vk::DescriptorPool::null() {
            shared.dispose(until, Parked::DescriptorPool(slot.descriptors));
        }
        self.destroy_segments(slot, until);
        if slot.pool != vk::CommandPool::null() {
            shared.dispose(until, Parked::CommandPool(slot.pool));
        }
    }
}

impl Drop for Executor {
    fn drop(&mut self) {
        if !self.gave_up
            && let Err(error) = self.finish()
        {
            tracing::warn!(%error, plan = self.plan.name, "work is not finished; what it uses is kept until it is");
        }
        self.drop_lent();
        let Some(last) = self.slots.iter().filter_map(|s| s.ticket).max() else {
            self.slots.iter().for_each(|s| self.destroy_slot(s, Ticket(0)));
            return;
        };
        let uniforms = self.slots.iter().filter_map(|s| s.uniforms.as_ref());
        for buffer in self.externals.iter().flatten().chain(&self.arena).chain(uniforms) {
            buffer.0.busy.until(last);
        }
        for image in self.images.iter().flatten().chain(&self.slot_images) {
            image.0.busy.until(last);
        }
        self.slots.iter().for_each(|s| self.destroy_slot(s, last));
    }
}

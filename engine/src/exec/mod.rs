//! Execution of plans: binds memory, records one command buffer per frame in flight, replays it.
//!
//! Promises: once every slot is recorded with the memory that it replays, a replay waits only for its own slot, copies
//! the uniforms, and submits. It allocates and records nothing. Executors of one device are ordered by submission. The
//! plan resolves hazards inside a replay.

mod bind;
mod external;
mod record;
mod recorded;
mod time;

pub use external::{Completion, Recording, SemaphorePoint};

use recorded::Recorded;

use crate::device::{DeferredObject, Device, ObjectKind, Ticket};
use crate::error::{Error, Result};
pub use crate::graph::dump::PassTime;
use crate::graph::{Buffer, BufferKind, Image, Plan, Use};
use crate::memory::{DeviceBuffer, DeviceImage, Location};
use ash::vk;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Execution options.
#[derive(Clone, Debug)]
pub struct ExecOptions {
    /// Replays in flight; each has its own uniforms.
    pub frames_in_flight: usize,
    /// Writes two timestamps around every pass.
    pub timestamps: bool,
    /// Fills the arena with one bits before each replay. Exposes reads of unwritten memory.
    pub poison: bool,
    /// Arena shared with other executors of the device; own memory if absent or too small.
    pub arena: Option<DeviceBuffer>,
}

impl Default for ExecOptions {
    fn default() -> Self {
        ExecOptions { frames_in_flight: 2, timestamps: false, poison: false, arena: None }
    }
}

/// Executable plan with its memory.
pub struct Executor {
    device: Device,
    plan: Arc<Plan>,
    options: ExecOptions,
    /// By buffer; `None` for uniforms and transients.
    externals: Vec<Option<DeviceBuffer>>,
    /// By buffer; `Some` only for external images.
    images: Vec<Option<DeviceImage>>,
    /// Images of the plan's image slots.
    slot_images: Vec<DeviceImage>,
    arena: Option<DeviceBuffer>,
    /// By buffer: byte offset in a slot's uniform memory.
    uniform_offsets: Vec<u64>,
    slots: Vec<Slot>,
    /// Indices of the external buffers whose memory alternates.
    alternating: Vec<usize>,
    /// Whether the kernels are compiled.
    compiled: bool,
    next: usize,
    uniform_bytes: u64,
    /// Slots recorded into command buffers of a host.
    host_slots: Vec<external::HostSlot>,
    times: time::Times,
    host: HostTimes,
    /// Whether a wait failed: work in flight is not awaited again, and its resources are released once it ends.
    wait_failed: bool,
}

/// Host time of replays since the executor was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HostTimes {
    /// Submitted replays.
    pub replays: u64,
    /// Submitted replays that were recorded first.
    pub recordings: u64,
    /// Time in [`Executor::submit`] without waiting: uniforms, recording, submission.
    pub work_time: Duration,
    /// Part of `work_time` inside `vkQueueSubmit2`.
    pub submit_time: Duration,
    /// Time waiting for the device, in [`Executor::submit`] and [`Executor::finish`].
    pub wait_time: Duration,
}

impl std::ops::Add for HostTimes {
    type Output = HostTimes;

    fn add(self, other: HostTimes) -> HostTimes {
        HostTimes {
            replays: self.replays + other.replays,
            recordings: self.recordings + other.recordings,
            work_time: self.work_time + other.work_time,
            submit_time: self.submit_time + other.submit_time,
            wait_time: self.wait_time + other.wait_time,
        }
    }
}

impl HostTimes {
    /// Returns seconds per replay since `earlier`: host work without submission, and submission. Zero without
    /// replays.
    pub fn since(&self, earlier: &HostTimes) -> (f64, f64) {
        let replays = (self.replays - earlier.replays).max(1) as f64;
        let submitting = (self.submit_time - earlier.submit_time).as_secs_f64();
        let working = (self.work_time - earlier.work_time).as_secs_f64();
        ((working - submitting).max(0.0) / replays, submitting / replays)
    }
}

/// Resources of one replay in flight.
struct Slot {
    /// Recordings, one for each combination of alternating memory.
    recorded: Vec<Recorded>,
    queries: vk::QueryPool,
    uniforms: Option<DeviceBuffer>,
    ticket: Option<Ticket>,
}

impl Executor {
    /// Creates the arena and slots of a plan.
    ///
    /// # Errors
    /// If memory runs out, or the plan exceeds the device's limits
    /// ([`DeviceInfo::check_plan`](crate::DeviceInfo::check_plan)).
    pub fn new(device: &Device, plan: Arc<Plan>, options: ExecOptions) -> Result<Executor> {
        device.info().check_plan(&plan)?;
        device.0.collect_plan(&plan);
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
                        // Kernels may also bind it as a storage buffer.
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
            slots: Vec::new(),
            alternating: Vec::new(),
            compiled: false,
            next: 0,
            uniform_bytes,
            host_slots: Vec::new(),
            times: time::Times::new(&plan, options.timestamps && device.info().timestamp_period > 0.0),
            host: HostTimes::default(),
            wait_failed: false,
            plan,
            options,
        };
        for (number, slot) in executor.plan.image_slots.iter().enumerate() {
            let name = format!("image {number} of {}", executor.plan.name);
            executor.slot_images.push(device.image(&name, slot.size, slot.format)?);
        }
        for _ in 0..executor.frames() {
            let slot = executor.slot()?;
            executor.slots.push(slot);
        }
        Ok(executor)
    }

    /// Returns the number of replays in flight.
    fn frames(&self) -> usize {
        self.options.frames_in_flight.max(1)
    }

    /// Returns the plan.
    pub fn plan(&self) -> &Arc<Plan> {
        &self.plan
    }

    /// Returns the device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the arena's memory, to share with other executors.
    pub fn arena(&self) -> Option<&DeviceBuffer> {
        self.arena.as_ref()
    }

    /// Binds memory to an external buffer of the plan. Rebinding waits for the replays in flight and records again;
    /// [`Executor::alternate`] does not.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if the memory is smaller than declared.
    pub fn bind(&mut self, buffer: Buffer, memory: &DeviceBuffer) -> Result<()> {
        memory.check_range(0, self.plan.buffers[buffer.index()].bytes)?;
        let place = &mut self.externals[buffer.index()];
        if place.as_ref().is_some_and(|old| Arc::ptr_eq(&old.0, &memory.0)) {
            return Ok(());
        }
        // Replays in flight use the memory that recordings keep alive.
        if place.is_some() || !self.alternating.is_empty() {
            self.finish()?;
        }
        self.externals[buffer.index()] = Some(memory.clone());
        self.forget_recordings();
        Ok(())
    }

    /// Binds an image to an external image of the plan; like [`Executor::bind`].
    ///
    /// # Errors
    /// [`Error::WrongImage`] if size or format differ from the declaration; [`Error::NotStorageImage`] if a kernel
    /// uses the image but its format does not support storage.
    pub fn bind_image(&mut self, image: Image, memory: &DeviceImage) -> Result<()> {
        let info = &self.plan.buffers[image.index()];
        let shape = |[width, height]: [u32; 2], format| format!("{width}x{height} {format}");
        let bound = shape(memory.size(), memory.format());
        let declared = info.image.map_or("a buffer".to_owned(), |image| shape(image.size, image.format));
        if declared != bound {
            return Err(Error::WrongImage { image: info.name.clone(), bound, declared });
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
        if place.is_some() || !self.alternating.is_empty() {
            self.finish()?;
        }
        self.images[image.index()] = Some(memory.clone());
        self.forget_recordings();
        Ok(())
    }

    /// Replays the plan with these uniforms; returns the ticket of its end.
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
        if self.device.0.is_planning() {
            self.host.replays += 1;
            return Ok(self.device.last_ticket());
        }
        let begin = Instant::now();
        let index = self.next;
        let waited = self.retire(index, self.device.timeout())?;
        self.write_uniforms(&self.slots[index], uniforms)?;
        let commands = self.recorded(index)?;
        let submit_start = Instant::now();
        let ticket = self.device.0.submit_between(commands, waits, signals, &self.plan.name)?;
        self.host.submit_time += submit_start.elapsed();
        self.slots[index].ticket = Some(ticket);
        self.next = (index + 1) % self.slots.len();
        self.host.replays += 1;
        self.host.work_time += begin.elapsed().saturating_sub(waited);
        Ok(ticket)
    }

    fn write_uniforms(&self, slot: &Slot, uniforms: &[(Buffer, &[u8])]) -> Result<()> {
        let Some(memory) = &slot.uniforms else { return Ok(()) };
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

    /// Like [`Executor::finish`], with an explicit time limit per replay. May be called again after a timeout.
    ///
    /// # Errors
    /// [`Error::Timeout`] with the unfinished pass, if timestamps are enabled; [`Error::DeviceLost`].
    pub fn finish_within(&mut self, limit: Duration) -> Result<()> {
        for i in 0..self.slots.len() {
            self.retire((self.next + i) % self.slots.len(), limit)?;
        }
        Ok(())
    }

    /// Waits for the replay of a slot, if any, and collects its times. Returns the time waited.
    fn retire(&mut self, index: usize, limit: Duration) -> Result<Duration> {
        let Some(ticket) = self.slots[index].ticket else { return Ok(Duration::ZERO) };
        let begin = Instant::now();
        if let Err(mut error) = self.device.wait_within(ticket, &self.plan.name, limit) {
            self.wait_failed = true;
            if let Error::Timeout { pass, .. } = &mut error {
                *pass = self.times.running(&self.device, self.slots[index].queries);
            }
            return Err(error);
        }
        self.slots[index].ticket = None;
        let waited = begin.elapsed();
        self.host.wait_time += waited;
        self.times.collect(&self.device, self.slots[index].queries)?;
        Ok(waited)
    }

    /// Returns the host time of all replays.
    pub fn host_times(&self) -> HostTimes {
        self.host
    }

    /// Returns and clears the nanoseconds of each pass in the finished replays. Empty without timestamps.
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
        let mut slot = Slot {
            recorded: Vec::new(),
            queries: vk::QueryPool::null(),
            uniforms: self.slot_uniforms()?,
            ticket: None,
        };
        if let Err(error) = self.fill_slot(&mut slot) {
            self.destroy_slot(&slot, Ticket(0));
            return Err(error);
        }
        Ok(slot)
    }

    fn fill_slot(&self, slot: &mut Slot) -> Result<()> {
        slot.recorded.push(self.new_recording()?);
        let shared = &self.device.0;
        if self.times.enabled() {
            let info = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(2 * self.plan.passes.len() as u32);
            // SAFETY: the device is alive.
            slot.queries =
                shared.gate.make(ObjectKind::QueryPool, "vkCreateQueryPool", &self.plan.name, || unsafe {
                    shared.raw.create_query_pool(&info, None)
                })?;
            // Queries may be read before the first replay has reset them.
            // SAFETY: the pool was created with that many queries; host query reset is a required feature.
            unsafe { shared.raw.reset_query_pool(slot.queries, 0, 2 * self.plan.passes.len() as u32) };
        }
        Ok(())
    }

    /// Destroys a slot's resources once the timeline has passed `until`.
    fn destroy_slot(&self, slot: &Slot, until: Ticket) {
        let shared = &self.device.0;
        if slot.queries != vk::QueryPool::null() {
            shared.dispose(until, DeferredObject::QueryPool(slot.queries));
        }
        slot.recorded.iter().for_each(|recorded| self.destroy_recording(recorded, until));
    }
}

impl Drop for Executor {
    fn drop(&mut self) {
        if !self.wait_failed
            && let Err(error) = self.finish()
        {
            tracing::warn!(%error, plan = self.plan.name, "work is not finished; its resources are released once it is");
        }
        self.drop_host_slots();
        let Some(last) = self.slots.iter().filter_map(|s| s.ticket).max() else {
            self.slots.iter().for_each(|s| self.destroy_slot(s, Ticket(0)));
            return;
        };
        let uniforms = self.slots.iter().filter_map(|s| s.uniforms.as_ref());
        let alternating = self.slots.iter().flat_map(|s| &s.recorded).flat_map(|r| r.memory.iter().flatten());
        for buffer in self.externals.iter().flatten().chain(&self.arena).chain(uniforms).chain(alternating) {
            buffer.0.busy.until(last);
        }
        for image in self.images.iter().flatten().chain(&self.slot_images) {
            image.0.busy.until(last);
        }
        self.slots.iter().for_each(|s| self.destroy_slot(s, last));
    }
}

//! Plans in a host's frame: recorded into its command buffers, or submitted between its semaphores.
//!
//! Promises: recording submits nothing, waits for nothing and touches no queue. The resources of a recording
//! (descriptors, uniforms, bound memory) stay valid until the host reports its submission as done. The host owns the
//! command buffer, its submission, and the order against other queues.

use super::{Executor, Slot};
use crate::device::{DeferredObject, Device, Ticket};
use crate::error::{Error, Result};
use crate::graph::Buffer;
use crate::memory::{DeviceBuffer, DeviceImage};
use ash::vk;
use std::sync::{Arc, Mutex, MutexGuard};

/// Semaphore that a submission waits for or signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SemaphorePoint {
    /// Vulkan semaphore.
    pub semaphore: vk::Semaphore,
    /// Value of a timeline semaphore; 0 for a binary one.
    pub value: u64,
}

impl SemaphorePoint {
    /// Returns a value of a timeline semaphore.
    pub fn timeline(semaphore: vk::Semaphore, value: u64) -> SemaphorePoint {
        SemaphorePoint { semaphore, value }
    }

    /// Returns a binary semaphore.
    pub fn binary(semaphore: vk::Semaphore) -> SemaphorePoint {
        SemaphorePoint { semaphore, value: 0 }
    }

    fn info(&self) -> vk::SemaphoreSubmitInfo<'static> {
        vk::SemaphoreSubmitInfo::default()
            .semaphore(self.semaphore)
            .value(self.value)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
    }
}

/// Condition that marks a host's submission as done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Completion {
    /// Value of a timeline semaphore.
    Timeline(vk::Semaphore, u64),
    /// Signaled fence. It must not be reset before the recording is observed as done.
    Fence(vk::Fence),
}

/// State of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RecordingState {
    /// The host has not reported its end.
    Pending,
    /// Done once the condition is met.
    Completion(Completion),
    /// Done.
    Done,
}

/// Token of a plan recorded into a host's command buffer.
///
/// The slot is reused only after one of the calls below. Dropping the token without a call keeps the slot in use.
#[derive(Debug)]
#[must_use = "the slot stays in use until the host reports when its submission is done"]
pub struct Recording(Arc<Mutex<RecordingState>>);

impl Recording {
    /// Marks the submission as done, or as never to be made.
    ///
    /// # Safety
    /// No submission of the command buffer is pending, and none follows without recording it again.
    pub unsafe fn release(self) {
        *lock(&self.0) = RecordingState::Done;
    }

    /// Marks the submission as done once a condition is met.
    ///
    /// # Safety
    /// As for [`Recording::release`], from the moment at which `until` is met. The semaphore or fence comes from the
    /// executor's device. It lives until the recording is observed as done ([`Executor::recordings`]) or the executor
    /// is dropped.
    pub unsafe fn until(self, until: Completion) {
        *lock(&self.0) = RecordingState::Completion(until);
    }
}

fn lock(state: &Mutex<RecordingState>) -> MutexGuard<'_, RecordingState> {
    state.lock().unwrap_or_else(|e| e.into_inner())
}

/// Bound buffers and images.
type Bindings = (Vec<Option<DeviceBuffer>>, Vec<Option<DeviceImage>>);

/// Resources of one recording.
pub(super) struct HostSlot {
    /// Has no command pool: the commands are the host's.
    slot: Slot,
    descriptors: vk::DescriptorPool,
    state: Arc<Mutex<RecordingState>>,
    /// Bound memory, kept alive if the executor binds other memory.
    _bindings: Bindings,
}

impl HostSlot {
    /// Returns whether the recording is done. Waits at most `timeout` nanoseconds.
    fn done(&self, device: &Device, plan: &str, timeout: u64) -> Result<bool> {
        let shared = &device.0;
        let reached = match *lock(&self.state) {
            RecordingState::Pending => return Ok(false),
            RecordingState::Done => return Ok(true),
            RecordingState::Completion(Completion::Timeline(semaphore, value)) => {
                let (semaphores, values) = ([semaphore], [value]);
                let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
                // SAFETY: the host promised that the semaphore is alive.
                shared.gate.call("vkWaitSemaphores", plan, || unsafe { shared.raw.wait_semaphores(&info, timeout) })
            }
            RecordingState::Completion(Completion::Fence(fence)) => {
                // SAFETY: the host promised that the fence is alive.
                shared
                    .gate
                    .call("vkWaitForFences", plan, || unsafe { shared.raw.wait_for_fences(&[fence], true, timeout) })
            }
        };
        match reached {
            Ok(()) => {
                *lock(&self.state) = RecordingState::Done;
                Ok(true)
            }
            Err(Error::Vulkan { result: vk::Result::TIMEOUT, .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }
}

impl Executor {
    /// Records one replay of the plan with these uniforms into a host's command buffer.
    ///
    /// All earlier commands are ordered before it and all later commands after it.
    ///
    /// Overwrites the bound compute pipeline, descriptor set 0 and push constants. After an error the command buffer
    /// may hold part of the plan; record it again.
    ///
    /// # Errors
    /// [`Error::SlotsInUse`] if as many recordings as frames in flight are not done; if an external buffer is unbound,
    /// memory runs out or the device fails.
    ///
    /// # Safety
    /// The host promises:
    /// * The command buffer is being recorded, outside a render pass. It comes from this device and from a pool of
    ///   the device's queue family. Nothing else records into it during the call.
    /// * It is submitted at most once at a time, to the queue that the device submits to. Otherwise the host orders
    ///   it against all other users of the bound memory.
    /// * The host reports the returned token's completion truthfully.
    pub unsafe fn record_into(
        &mut self,
        commands: vk::CommandBuffer,
        uniforms: &[(Buffer, &[u8])],
    ) -> Result<Recording> {
        if commands == vk::CommandBuffer::null() {
            return Err(Error::Host("the command buffer is null".into()));
        }
        let index = self.free_host_slot()?;
        self.compile()?;
        let shared = &self.device.0;
        let name = &self.plan.name;
        let HostSlot { slot, descriptors, .. } = &self.host_slots[index];
        self.write_uniforms(slot, uniforms)?;
        // SAFETY: the previous recording of these sets is done.
        shared.gate.call("vkResetDescriptorPool", name, || unsafe {
            shared.raw.reset_descriptor_pool(*descriptors, vk::DescriptorPoolResetFlags::empty())
        })?;
        self.record_barrier(commands, &entry(), &self.plan.entry)?;
        self.body(commands, slot, *descriptors)?;
        self.record_barrier(commands, &exit(), &self.plan.exit)?;
        let state = Arc::new(Mutex::new(RecordingState::Pending));
        let bindings = (self.externals.clone(), self.images.clone());
        let host_slot = &mut self.host_slots[index];
        host_slot.state = state.clone();
        host_slot._bindings = bindings;
        Ok(Recording(state))
    }

    /// Like [`Executor::submit`], with wait and signal semaphores.
    ///
    /// # Errors
    /// As [`Executor::submit`].
    ///
    /// # Safety
    /// The semaphores come from this device and live until the replay is done. A signaled timeline value exceeds all
    /// earlier values. An awaited binary semaphore has a pending signal; a signaled one has none.
    pub unsafe fn submit_with(
        &mut self,
        uniforms: &[(Buffer, &[u8])],
        waits: &[SemaphorePoint],
        signals: &[SemaphorePoint],
    ) -> Result<Ticket> {
        let infos = |points: &[SemaphorePoint]| points.iter().map(SemaphorePoint::info).collect::<Vec<_>>();
        self.submit_between(uniforms, &infos(waits), &infos(signals))
    }

    /// Returns the number of recordings not known to be done. Does not wait.
    ///
    /// # Errors
    /// If the device fails.
    pub fn recordings(&self) -> Result<usize> {
        let mut open = 0;
        for host_slot in &self.host_slots {
            open += usize::from(!host_slot.done(&self.device, &self.plan.name, 0)?);
        }
        Ok(open)
    }

    /// Returns the index of a free slot.
    fn free_host_slot(&mut self) -> Result<usize> {
        for (index, host_slot) in self.host_slots.iter().enumerate() {
            if host_slot.done(&self.device, &self.plan.name, 0)? {
                return Ok(index);
            }
        }
        let slots = self.frames();
        if self.host_slots.len() >= slots {
            return Err(Error::SlotsInUse { plan: self.plan.name.clone(), slots });
        }
        let uniforms = self.slot_uniforms()?;
        let slot = Slot { recorded: Vec::new(), queries: vk::QueryPool::null(), uniforms, ticket: None };
        self.host_slots.push(HostSlot {
            slot,
            descriptors: self.descriptor_pool()?,
            state: Arc::new(Mutex::new(RecordingState::Done)),
            _bindings: Bindings::default(),
        });
        Ok(self.host_slots.len() - 1)
    }

    /// Waits for recordings with a known completion condition. Releases their resources.
    pub(super) fn drop_host_slots(&mut self) {
        let limit = u64::try_from(self.device.timeout().as_nanos()).unwrap_or(u64::MAX);
        let host_slots = std::mem::take(&mut self.host_slots);
        if host_slots.iter().all(|l| l.done(&self.device, &self.plan.name, limit).unwrap_or(false)) {
            for HostSlot { slot, descriptors, .. } in &host_slots {
                self.destroy_slot(slot, Ticket(0));
                self.device.0.dispose(Ticket(0), DeferredObject::DescriptorPool(*descriptors));
            }
            return;
        }
        tracing::error!(
            plan = self.plan.name,
            "a host still holds recordings of a dropped plan; their resources are leaked"
        );
        // They may run at any time: neither memory nor pipelines nor the device may be destroyed.
        std::mem::forget(host_slots);
        std::mem::forget((self.externals.clone(), self.images.clone(), self.arena.clone(), self.slot_images.clone()));
        std::mem::forget(self.device.clone());
    }
}

/// Orders all earlier commands of the host before the plan.
fn entry() -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
        .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
        .dst_stage_mask(plan_stages())
        .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
}

/// Orders the plan before all later commands of the host, host reads included.
fn exit() -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(plan_stages())
        .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
        .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS | vk::PipelineStageFlags2::HOST)
        .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE | vk::AccessFlags2::HOST_READ)
}

fn plan_stages() -> vk::PipelineStageFlags2 {
    vk::PipelineStageFlags2::COMPUTE_SHADER
        | vk::PipelineStageFlags2::ALL_TRANSFER
        | vk::PipelineStageFlags2::DRAW_INDIRECT
}

//! Plans in a host's hands: recorded into its command buffers, or submitted between its semaphores.
//!
//! Promises: recording submits nothing, waits for nothing and touches no queue; what a recording needs (descriptors, a
//! slot of uniforms, the memory that was bound) stays untouched until the host has said that its submission is done.
//! Leaves to the host everything outside: the command buffer, its submission, and the order against other queues.

use super::{Executor, Slot};
use crate::device::{Device, Ticket};
use crate::error::{Error, Result};
use crate::graph::Buffer;
use crate::memory::{DeviceBuffer, DeviceImage};
use ash::vk;
use std::sync::{Arc, Mutex, MutexGuard};

/// A semaphore that a submission waits for or signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SemaphorePoint {
    /// The semaphore.
    pub semaphore: vk::Semaphore,
    /// The value of a timeline semaphore; nothing for a binary one.
    pub value: u64,
}

impl SemaphorePoint {
    /// A value of a timeline semaphore.
    pub fn timeline(semaphore: vk::Semaphore, value: u64) -> SemaphorePoint {
        SemaphorePoint { semaphore, value }
    }

    /// A binary semaphore.
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

/// What covers a host's submission: when it is reached, the submission is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Until {
    /// A value of a timeline semaphore.
    Timeline(vk::Semaphore, u64),
    /// A fence is signaled. It must not be reset before the recording is seen to be done.
    Fence(vk::Fence),
}

/// How far a recording is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Hold {
    /// Nothing is known of it.
    Held,
    /// It is done when this is.
    Until(Until),
    /// It is done.
    Done,
}

/// A plan recorded into a host's command buffer. Its slot is used again only after one of the calls below; dropping the
/// token without any says nothing, and the slot stays held.
#[derive(Debug)]
#[must_use = "the slot stays held until the host says when its submission is done"]
pub struct Recorded(Arc<Mutex<Hold>>);

impl Recorded {
    /// The submission is done, or will never be made.
    ///
    /// # Safety
    /// No submission of the command buffer is pending, and none will be made without recording it anew.
    pub unsafe fn release(self) {
        *lock(&self.0) = Hold::Done;
    }

    /// The submission is done when something is reached.
    ///
    /// # Safety
    /// As for [`Recorded::release`], from the moment on which `until` is reached. The semaphore or fence comes from the
    /// executor's device and lives until the recording was seen to be done ([`Executor::recordings`]) or the executor is
    /// gone.
    pub unsafe fn until(self, until: Until) {
        *lock(&self.0) = Hold::Until(until);
    }
}

fn lock(hold: &Mutex<Hold>) -> MutexGuard<'_, Hold> {
    hold.lock().unwrap_or_else(|e| e.into_inner())
}

/// Buffers and images that were bound.
type Keeps = (Vec<Option<DeviceBuffer>>, Vec<Option<DeviceImage>>);

/// What one recording uses.
pub(super) struct Lent {
    /// Without a command pool: the commands are the host's.
    pub slot: Slot,
    hold: Arc<Mutex<Hold>>,
    /// What was bound; binding anew must not free it.
    _keeps: Keeps,
}

impl Lent {
    /// Whether the recording is done; looks, and waits at most so many nanoseconds.
    fn done(&self, device: &Device, plan: &str, timeout: u64) -> Result<bool> {
        let shared = &device.0;
        let reached = match *lock(&self.hold) {
            Hold::Held => return Ok(false),
            Hold::Done => return Ok(true),
            Hold::Until(Until::Timeline(semaphore, value)) => {
                let (semaphores, values) = ([semaphore], [value]);
                let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
                // SAFETY: the host promised that the semaphore is alive.
                shared.gate.call("vkWaitSemaphores", plan, || unsafe { shared.raw.wait_semaphores(&info, timeout) })
            }
            Hold::Until(Until::Fence(fence)) => {
                // SAFETY: the host promised that the fence is alive.
                shared
                    .gate
                    .call("vkWaitForFences", plan, || unsafe { shared.raw.wait_for_fences(&[fence], true, timeout) })
            }
        };
        match reached {
            Ok(()) => {
                *lock(&self.hold) = Hold::Done;
                Ok(true)
            }
            Err(Error::Vulkan { result: vk::Result::TIMEOUT, .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }
}

impl Executor {
    /// Records one replay of the plan, with these uniforms, into a host's command buffer, between whatever the host
    /// records before and after. Everything before is ordered before it and everything after behind it. A plan for two
    /// queues has full barriers where one would wait for the other.
    ///
    /// The bound compute pipeline, its descriptor set 0 and push constants are not what they were afterwards. After an
    /// error the command buffer may hold part of the plan and is to be recorded anew.
    ///
    /// # Errors
    /// [`Error::SlotsHeld`] if as many recordings as there are frames in flight are not done yet; if an external buffer is
    /// not bound, memory runs out or the device fails; [`Error::Host`] for a plan with histories.
    ///
    /// # Safety
    /// The host promises:
    /// * the command buffer is being recorded, outside a render pass, comes from this device and from a pool of the queue
    ///   family that the device was opened or adopted with, and nobody else records into it during the call;
    /// * it is submitted at most once at a time, to the queue that the device submits to, or ordered by the host against
    ///   everything else that uses the memory bound here;
    /// * what it says of the returned token is true.
    pub unsafe fn record_into(
        &mut self,
        commands: vk::CommandBuffer,
        uniforms: &[(Buffer, &[u8])],
    ) -> Result<Recorded> {
        if commands == vk::CommandBuffer::null() {
            return Err(Error::Host("the command buffer is null".into()));
        }
        if self.has_histories() {
            let plan = &self.plan.name;
            let text = format!("\"{plan}\" has histories, which change places by the order of submission; submit it");
            return Err(Error::Host(text));
        }
        let index = self.free_lent()?;
        let shared = &self.device.0;
        let name = &self.plan.name;
        let slot = &self.lent[index].slot;
        self.write_uniforms(slot, uniforms)?;
        // SAFETY: the recording that used these sets is done.
        shared.gate.call("vkResetDescriptorPool", name, || unsafe {
            shared.raw.reset_descriptor_pool(slot.descriptors, vk::DescriptorPoolResetFlags::empty())
        })?;
        self.change(commands, &entry(), &self.plan.entry)?;
        self.body(commands, slot)?;
        self.change(commands, &exit(), &self.plan.exit)?;
        let hold = Arc::new(Mutex::new(Hold::Held));
        let keeps = (self.externals.clone(), self.images.clone());
        let lent = &mut self.lent[index];
        lent.hold = hold.clone();
        lent._keeps = keeps;
        Ok(Recorded(hold))
    }

    /// As [`Executor::submit`], after some semaphores and before others.
    ///
    /// # Errors
    /// As [`Executor::submit`].
    ///
    /// # Safety
    /// The semaphores come from this device and live until the replay is done. A value of a timeline semaphore to be
    /// signaled is above every value so far; a binary semaphore to be waited for has a signal on its way, and one to be
    /// signaled has none.
    pub unsafe fn submit_with(
        &mut self,
        uniforms: &[(Buffer, &[u8])],
        waits: &[SemaphorePoint],
        signals: &[SemaphorePoint],
    ) -> Result<Ticket> {
        let infos = |points: &[SemaphorePoint]| points.iter().map(SemaphorePoint::info).collect::<Vec<_>>();
        self.submit_between(uniforms, &infos(waits), &infos(signals))
    }

    /// How many recordings are not done yet, as far as the host has said and the device tells. Waits for nothing.
    ///
    /// # Errors
    /// If the device fails.
    pub fn recordings(&self) -> Result<usize> {
        let mut open = 0;
        for lent in &self.lent {
            open += usize::from(!lent.done(&self.device, &self.plan.name, 0)?);
        }
        Ok(open)
    }

    /// A slot that no recording uses.
    fn free_lent(&mut self) -> Result<usize> {
        for (index, lent) in self.lent.iter().enumerate() {
            if lent.done(&self.device, &self.plan.name, 0)? {
                return Ok(index);
            }
        }
        let slots = self.frames();
        if self.lent.len() >= slots {
            return Err(Error::SlotsHeld { plan: self.plan.name.clone(), slots });
        }
        let uniforms = self.slot_uniforms()?;
        let slot = Slot {
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            descriptors: self.descriptor_pool()?,
            queries: vk::QueryPool::null(),
            uniforms,
            recorded: false,
            swapped: false,
            segments: None,
            ticket: None,
        };
        self.lent.push(Lent { slot, hold: Arc::new(Mutex::new(Hold::Done)), _keeps: Keeps::default() });
        Ok(self.lent.len() - 1)
    }

    /// Waits for the recordings of which the host has said when they are done, and gives back what they used.
    pub(super) fn drop_lent(&mut self) {
        let limit = u64::try_from(self.device.timeout().as_nanos()).unwrap_or(u64::MAX);
        let lent = std::mem::take(&mut self.lent);
        if lent.iter().all(|l| l.done(&self.device, &self.plan.name, limit).unwrap_or(false)) {
            lent.iter().for_each(|l| self.destroy_slot(&l.slot, Ticket(0)));
            return;
        }
        tracing::error!(
            plan = self.plan.name,
            "a host still holds recordings of a plan that goes; what they use stays"
        );
        // They may run at any time: neither memory nor pipelines nor the device may go.
        std::mem::forget(lent);
        std::mem::forget((self.externals.clone(), self.images.clone(), self.arena.clone(), self.slot_images.clone()));
        std::mem::forget(self.device.clone());
    }
}

/// Whatever the host did before, before us.
fn entry() -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
        .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
        .dst_stage_mask(ours())
        .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
}

/// Whatever the host does after, behind us; its memory too, for reading back.
fn exit() -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(ours())
        .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
        .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS | vk::PipelineStageFlags2::HOST)
        .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE | vk::AccessFlags2::HOST_READ)
}

fn ours() -> vk::PipelineStageFlags2 {
    vk::PipelineStageFlags2::COMPUTE_SHADER
        | vk::PipelineStageFlags2::ALL_TRANSFER
        | vk::PipelineStageFlags2::DRAW_INDIRECT
}

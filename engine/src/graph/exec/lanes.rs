//! Plans for two queues: a command buffer for each segment, submitted in the order of the plan, joined by timelines.
//!
//! Segments of the main lane signal the device's timeline like everything else on it, those of the second lane one that the
//! device keeps for them. Whoever waits was submitted after what it waits for, so that both lanes may even share one queue.

use super::{Executor, Slot};
use crate::device::{ObjectKind, Parked, Ticket, semaphore};
use crate::error::Result;
use crate::graph::plan::Lane;
use ash::vk;

/// What an executor has for its second lane.
pub(super) struct Side {
    timeline: vk::Semaphore,
    /// What this executor reached on it.
    submitted: u64,
    /// By segment: the value that it signaled last.
    values: Vec<u64>,
}

/// What a slot has for it.
pub(super) struct Segments {
    /// For the second lane; the main lane's are from the slot's own pool.
    pool: vk::CommandPool,
    /// By segment.
    commands: Vec<vk::CommandBuffer>,
}

impl Executor {
    /// Makes the second lane's timeline if the plan has one.
    pub(super) fn make_side(&mut self) -> Result<()> {
        if self.plan.segments.len() < 2 {
            return Ok(());
        }
        let timeline = self.device.0.second_timeline()?;
        self.side = Some(Side { timeline, submitted: 0, values: vec![0; self.plan.segments.len()] });
        Ok(())
    }

    /// Makes a slot's command buffers for the segments.
    pub(super) fn make_segments(&self, slot: &mut Slot) -> Result<()> {
        if self.side.is_none() {
            return Ok(());
        }
        let (shared, name) = (&self.device.0, &self.plan.name);
        let family = shared.second.as_ref().map_or(shared.queue_family, |second| second.family);
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(family);
        // SAFETY: the device is alive.
        let pool = shared.gate.make(ObjectKind::CommandPool, "vkCreateCommandPool", name, || unsafe {
            shared.raw.create_command_pool(&info, None)
        })?;
        // In the slot from here on, so that it is given back with it.
        let segments = slot.segments.insert(Segments { pool, commands: Vec::new() });
        for segment in &self.plan.segments {
            let pool = if segment.lane == Lane::Main { slot.pool } else { segments.pool };
            let info = vk::CommandBufferAllocateInfo::default()
                .command_pool(pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            // SAFETY: the pool was made from this device.
            let made = shared
                .gate
                .call("vkAllocateCommandBuffers", name, || unsafe { shared.raw.allocate_command_buffers(&info) })?;
            segments.commands.extend(made);
        }
        Ok(())
    }

    /// Records a slot's segments. The pools and sets of the main lane have been reset.
    pub(super) fn record_segments(&self, slot: &Slot, segments: &Segments) -> Result<()> {
        let (shared, plan) = (&self.device.0, &self.plan);
        let raw = &shared.raw;
        // SAFETY: the slot is not in flight.
        shared.gate.call("vkResetCommandPool", &plan.name, || unsafe {
            raw.reset_command_pool(segments.pool, vk::CommandPoolResetFlags::empty())
        })?;
        let last = plan.segments.len() - 1;
        for (at, (segment, &commands)) in plan.segments.iter().zip(&segments.commands).enumerate() {
            let begin = vk::CommandBufferBeginInfo::default();
            // SAFETY: the command buffer is not in flight and was reset with its pool.
            unsafe {
                shared.gate.call("vkBeginCommandBuffer", &plan.name, || raw.begin_command_buffer(commands, &begin))?;
            }
            if at == 0 {
                // Everything else begins after this segment, on either lane.
                self.reset_stamps(commands, slot);
                self.open(commands)?;
                self.prelude(commands);
            }
            if !segment.waits.is_empty() && shared.second.is_none() {
                // On one queue a barrier reaches as far as the wait. Layer 1.3.239 knows no timeline semaphores and would
                // miss the wait alone.
                self.barrier(commands, &super::record::everything());
            }
            self.groups(commands, slot, segment.groups.clone())?;
            if let Some(barrier) = &segment.last {
                self.barrier(commands, &super::record::translate(barrier));
            }
            if at == last {
                self.close(commands)?;
            }
            // SAFETY: recording began above.
            shared.gate.call("vkEndCommandBuffer", &plan.name, || unsafe { raw.end_command_buffer(commands) })?;
        }
        Ok(())
    }

    /// Submits a slot's segments, the first after `waits` and the last before `signals`; returns the end of the last one,
    /// which everything precedes.
    pub(super) fn submit_segments(
        &mut self,
        index: usize,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        signals: &[vk::SemaphoreSubmitInfo<'_>],
    ) -> Result<Ticket> {
        let shared = &self.device.0;
        let (Some(side), Some(segments)) = (&mut self.side, &self.slots[index].segments) else {
            return shared.submit_between(self.slots[index].commands, waits, signals, &self.plan.name);
        };
        // What others wait for or are waited for is the main lane's: it has the first segment and the last.
        let (given, last) = (waits, self.plan.segments.len() - 1);
        let mut ticket = Ticket(0);
        for (at, (segment, &commands)) in self.plan.segments.iter().zip(&segments.commands).enumerate() {
            // One wait for each lane is enough: the latest stands for all before it.
            let latest = |lane: Lane| {
                let waits = segment.waits.iter().filter(|&&wait| self.plan.segments[wait].lane == lane);
                waits.map(|&wait| side.values[wait]).max().unwrap_or(0)
            };
            let mut waits =
                vec![shared.point(Ticket(latest(Lane::Main))), semaphore(side.timeline, latest(Lane::Side))];
            waits.retain(|wait| wait.value > 0);
            if at == 0 {
                waits.extend_from_slice(given);
            }
            let result = if segment.lane == Lane::Main {
                let signals = if at == last { signals } else { &[] };
                shared.submit_between(commands, &waits, signals, &self.plan.name).map(|main| {
                    ticket = main;
                    main.0
                })
            } else {
                shared.submit_second(commands, &waits, &self.plan.name).inspect(|value| side.submitted = *value)
            };
            match result {
                Ok(value) => side.values[at] = value,
                Err(error) => {
                    // What was submitted of this replay runs all the same; nothing of it may be given back before.
                    let (semaphores, values) = ([side.timeline], [side.submitted]);
                    let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
                    let limit = u64::try_from(self.device.timeout().as_nanos()).unwrap_or(u64::MAX);
                    // SAFETY: the semaphore is alive.
                    let waited = shared.gate.call("vkWaitSemaphores", &self.plan.name, || unsafe {
                        shared.raw.wait_semaphores(&info, limit)
                    });
                    self.gave_up |= waited.is_err();
                    self.slots[index].ticket = (ticket > Ticket(0)).then_some(ticket);
                    return Err(error);
                }
            }
        }
        Ok(ticket)
    }

    /// Gives a slot's second pool back.
    pub(super) fn destroy_segments(&self, slot: &Slot, until: Ticket) {
        if let Some(segments) = &slot.segments {
            self.device.0.dispose(until, Parked::CommandPool(segments.pool));
        }
    }
}

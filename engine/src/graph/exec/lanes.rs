//! Two-queue execution: one command buffer per segment, submitted in plan order, joined by timelines.
//!
//! Main-lane segments signal the device's timeline. Side-lane segments signal a second timeline of the device. Every
//! wait follows its signal in submission order, so that both lanes may share one queue.

use super::{Executor, Slot};
use crate::device::{DeferredObject, ObjectKind, Ticket, semaphore};
use crate::error::Result;
use crate::graph::plan::Lane;
use ash::vk;

/// Executor state of the second lane.
pub(super) struct SideLane {
    timeline: vk::Semaphore,
    /// Last value that this executor submitted on it.
    submitted: u64,
    /// By segment: last signaled value.
    values: Vec<u64>,
}

/// Command buffers of a slot's segments.
pub(super) struct Segments {
    /// Pool of the second lane; the main lane uses the slot's own pool.
    pool: vk::CommandPool,
    /// By segment.
    commands: Vec<vk::CommandBuffer>,
}

impl Executor {
    /// Creates the second lane's state if the plan has several segments.
    pub(super) fn make_side(&mut self) -> Result<()> {
        if self.plan.segments.len() < 2 {
            return Ok(());
        }
        let timeline = self.device.0.second_timeline()?;
        self.side = Some(SideLane { timeline, submitted: 0, values: vec![0; self.plan.segments.len()] });
        Ok(())
    }

    /// Allocates a slot's command buffers for the segments.
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
        // Stored in the slot now, so that it is released with the slot.
        let segments = slot.segments.insert(Segments { pool, commands: Vec::new() });
        for segment in &self.plan.segments {
            let pool = if segment.lane == Lane::Main { slot.pool } else { segments.pool };
            let info = vk::CommandBufferAllocateInfo::default()
                .command_pool(pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            // SAFETY: the pool was created from this device.
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
                // All other segments begin after this one, on either lane.
                self.reset_stamps(commands, slot);
                self.open(commands)?;
                self.prelude(commands);
            }
            if !segment.waits.is_empty() && shared.second.is_none() {
                // On one queue, a barrier has the same effect as the wait. Layer 1.3.239 does not track timeline
                // semaphores and would miss the wait alone.
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

    /// Submits a slot's segments. Returns the ticket of the last one, which all others precede.
    ///
    /// The first segment waits for `waits`; the last one signals `signals`.
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
        // External waits and signals belong to the main lane, which has the first and the last segment.
        let (external_waits, last) = (waits, self.plan.segments.len() - 1);
        let mut ticket = Ticket(0);
        for (at, (segment, &commands)) in self.plan.segments.iter().zip(&segments.commands).enumerate() {
            // One wait per lane suffices: the latest value covers all earlier ones.
            let latest = |lane: Lane| {
                let waits = segment.waits.iter().filter(|&&wait| self.plan.segments[wait].lane == lane);
                waits.map(|&wait| side.values[wait]).max().unwrap_or(0)
            };
            let mut waits =
                vec![shared.point(Ticket(latest(Lane::Main))), semaphore(side.timeline, latest(Lane::Side))];
            waits.retain(|wait| wait.value > 0);
            if at == 0 {
                waits.extend_from_slice(external_waits);
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
                    // The submitted part of this replay still runs; its resources must not be released before it
                    // ends.
                    let (semaphores, values) = ([side.timeline], [side.submitted]);
                    let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
                    let limit = u64::try_from(self.device.timeout().as_nanos()).unwrap_or(u64::MAX);
                    // SAFETY: the semaphore is alive.
                    let waited = shared.gate.call("vkWaitSemaphores", &self.plan.name, || unsafe {
                        shared.raw.wait_semaphores(&info, limit)
                    });
                    self.wait_failed |= waited.is_err();
                    self.slots[index].ticket = (ticket > Ticket(0)).then_some(ticket);
                    return Err(error);
                }
            }
        }
        Ok(ticket)
    }

    /// Destroys a slot's second pool.
    pub(super) fn destroy_segments(&self, slot: &Slot, until: Ticket) {
        if let Some(segments) = &slot.segments {
            self.device.0.dispose(until, DeferredObject::CommandPool(segments.pool));
        }
    }
}

//! Recording of a plan into a command buffer.

use super::{Executor, Recorded, Slot};
use crate::device::Wanted;
use crate::error::Result;
use crate::graph::plan::{Barrier, Transition};
use crate::graph::{Accesses, Dispatch, Image, ImageState, PassKind, Stages};
use crate::memory::image::{WHOLE, packed_copy};
use ash::vk;

impl Executor {
    /// Records a command buffer of a slot.
    pub(super) fn record(&self, index: usize, which: usize) -> Result<()> {
        let shared = &self.device.0;
        let raw = &shared.raw;
        let plan = self.plan.clone();
        let slot = &self.slots[index];
        let Recorded { pool, commands, descriptors, .. } = slot.recorded[which];
        let begin = vk::CommandBufferBeginInfo::default();
        // SAFETY: the slot is not in flight (its ticket was awaited), so pool and sets may be reset.
        unsafe {
            shared.gate.call("vkResetCommandPool", &plan.name, || {
                raw.reset_command_pool(pool, vk::CommandPoolResetFlags::empty())
            })?;
            shared.gate.call("vkResetDescriptorPool", &plan.name, || {
                raw.reset_descriptor_pool(descriptors, vk::DescriptorPoolResetFlags::empty())
            })?;
        }
        // SAFETY: the command buffer was reset with its pool.
        unsafe {
            shared.gate.call("vkBeginCommandBuffer", &plan.name, || raw.begin_command_buffer(commands, &begin))?;
        }
        self.reset_stamps(commands, slot);
        self.open(commands)?;
        self.body(commands, slot, descriptors)?;
        self.close(commands)?;
        // SAFETY: recording began above.
        shared.gate.call("vkEndCommandBuffer", &plan.name, || unsafe { raw.end_command_buffer(commands) })
    }

    /// Records the barrier and layout transitions at the beginning of a replay.
    pub(super) fn open(&self, commands: vk::CommandBuffer) -> Result<()> {
        // Other plans and transfers may have used the same externals and arena just before. The entry therefore
        // orders everything on the queue, not only the hazards of this plan.
        let own = self.plan.groups.first().and_then(|group| group.barrier).unwrap_or_default();
        self.record_barrier(commands, &merge(everything(), translate(&own)), &self.plan.entry)
    }

    /// Records the barrier and layout transitions at the end of a replay.
    pub(super) fn close(&self, commands: vk::CommandBuffer) -> Result<()> {
        let results = vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::COMPUTE_SHADER | vk::PipelineStageFlags2::ALL_TRANSFER)
            .src_access_mask(vk::AccessFlags2::SHADER_STORAGE_WRITE | vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ);
        let own = self.plan.final_barrier.unwrap_or_default();
        self.record_barrier(commands, &merge(results, translate(&own)), &self.plan.exit)
    }

    /// Compiles the kernels of the plan before its first recording.
    pub(super) fn compile(&mut self) -> Result<()> {
        if !self.compiled {
            let wanted: Vec<_> = self.plan.passes.iter().filter_map(|pass| wanted(&pass.kind)).collect();
            self.device.0.compile(&wanted)?;
            self.compiled = true;
        }
        Ok(())
    }

    /// Records the passes between entry and exit barrier.
    ///
    /// `descriptors`: pool for the descriptor sets.
    pub(super) fn body(&self, commands: vk::CommandBuffer, slot: &Slot, descriptors: vk::DescriptorPool) -> Result<()> {
        self.prelude(commands);
        self.groups(commands, slot, descriptors)
    }

    /// Resets the timestamp queries of a slot.
    pub(super) fn reset_stamps(&self, commands: vk::CommandBuffer, slot: &Slot) {
        if slot.queries != vk::QueryPool::null() {
            let count = 2 * self.plan.passes.len() as u32;
            // SAFETY: the pool has two queries for every pass.
            unsafe { self.device.0.raw.cmd_reset_query_pool(commands, slot.queries, 0, count) };
        }
    }

    /// Records the poison fills, if enabled.
    pub(super) fn prelude(&self, commands: vk::CommandBuffer) {
        let plan = &self.plan;
        // A failed recording may have left labels open.
        self.device.0.instance.messages.close_all();
        if self.options.poison && (self.arena.is_some() || !self.slot_images.is_empty()) {
            let raw = &self.device.0.raw;
            if let Some(arena) = &self.arena {
                // SAFETY: the arena is alive; the fill is inside its size.
                unsafe {
                    raw.cmd_fill_buffer(commands, arena.0.raw, 0, plan.arena_bytes.next_multiple_of(4), u32::MAX);
                }
            }
            let ones = vk::ClearColorValue { uint32: [u32::MAX; 4] };
            for (image, slot) in self.slot_images.iter().zip(&plan.image_slots) {
                // Images used only as transfer sources cannot be cleared; no pass can read them before a copy writes
                // them.
                if slot.home != ImageState::TransferSource {
                    // SAFETY: the image is alive and in its home layout.
                    unsafe { raw.cmd_clear_color_image(commands, image.0.raw, layout(slot.home), &ones, &[WHOLE]) };
                }
            }
            self.barrier(commands, &everything());
        }
    }

    /// Records all groups.
    fn groups(&self, commands: vk::CommandBuffer, slot: &Slot, descriptors: vk::DescriptorPool) -> Result<()> {
        let plan = &self.plan;
        self.open_label(commands, &plan.name);
        for (g, group) in plan.groups.iter().enumerate() {
            if let (Some(barrier), true) = (&group.barrier, g > 0) {
                self.barrier(commands, &translate(barrier));
            }
            self.open_label(commands, &format!("group {g}"));
            for &pass in &group.passes {
                self.stamp(commands, slot, pass, false);
                self.open_label(commands, &plan.passes[pass].name);
                self.pass(commands, slot, descriptors, pass)?;
                self.close_label(commands);
                self.stamp(commands, slot, pass, true);
            }
            self.close_label(commands);
        }
        self.close_label(commands);
        Ok(())
    }

    fn pass(
        &self,
        commands: vk::CommandBuffer,
        slot: &Slot,
        descriptors: vk::DescriptorPool,
        pass: usize,
    ) -> Result<()> {
        let shared = &self.device.0;
        let raw = &shared.raw;
        let pass = &self.plan.passes[pass];
        match &pass.kind {
            PassKind::Compute { shader, specs, push, bindings, subgroup_size, dispatch } => {
                let pipeline = shared.pipeline(shader, specs, *subgroup_size)?;
                let set = self.descriptor_set((slot, descriptors), &pipeline, shader, bindings)?;
                // SAFETY: pipeline, layout and set belong together. The push constants have the size of the layout.
                // The builder has checked that indirect arguments lie inside their buffer.
                unsafe {
                    raw.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.raw);
                    let sets = [set];
                    let point = vk::PipelineBindPoint::COMPUTE;
                    raw.cmd_bind_descriptor_sets(commands, point, pipeline.layout, 0, &sets, &[]);
                    if !push.is_empty() {
                        raw.cmd_push_constants(commands, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, push);
                    }
                    match dispatch {
                        Dispatch::Groups([x, y, z]) => raw.cmd_dispatch(commands, *x, *y, *z),
                        Dispatch::Indirect { buffer, offset } => {
                            let (buffer, offset) = self.resolve(slot, &buffer.slice(*offset, 12))?;
                            raw.cmd_dispatch_indirect(commands, buffer, offset);
                        }
                    }
                }
            }
            PassKind::Fill { target, value } => {
                let (buffer, offset) = self.resolve(slot, target)?;
                // SAFETY: the builder has checked that the range is word-aligned and inside the buffer.
                unsafe { raw.cmd_fill_buffer(commands, buffer, offset, target.bytes, *value) };
            }
            PassKind::Copy { source, target } => {
                let (from, src_offset) = self.resolve(slot, source)?;
                let (to, dst_offset) = self.resolve(slot, target)?;
                let region = [vk::BufferCopy { src_offset, dst_offset, size: source.bytes }];
                // SAFETY: the builder has checked that both ranges are inside their buffers and do not overlap.
                unsafe { raw.cmd_copy_buffer(commands, from, to, &region) };
            }
            PassKind::CopyToImage { source, target } => {
                let (buffer, offset) = self.resolve(slot, source)?;
                let (image, home) = (self.image(*target)?, self.home(*target));
                let region = [packed_copy(offset, image.size())];
                // SAFETY: the builder has checked that the range holds exactly the packed image; the image is in this
                // layout.
                unsafe { raw.cmd_copy_buffer_to_image(commands, buffer, image.0.raw, home, &region) };
            }
            PassKind::CopyFromImage { source, target } => {
                let (buffer, offset) = self.resolve(slot, target)?;
                let (image, home) = (self.image(*source)?, self.home(*source));
                let region = [packed_copy(offset, image.size())];
                // SAFETY: as above.
                unsafe { raw.cmd_copy_image_to_buffer(commands, image.0.raw, home, buffer, &region) };
            }
            PassKind::ClearImage { target, value } => {
                let color = vk::ClearColorValue { uint32: *value };
                let (image, home) = (self.image(*target)?, self.home(*target));
                // SAFETY: the image is alive and in this layout.
                unsafe { raw.cmd_clear_color_image(commands, image.0.raw, home, &color, &[WHOLE]) };
            }
        }
        Ok(())
    }

    /// Records one memory barrier with layout transitions of the same scopes.
    pub(super) fn record_barrier(
        &self,
        commands: vk::CommandBuffer,
        barrier: &vk::MemoryBarrier2<'_>,
        transitions: &[Transition],
    ) -> Result<()> {
        let mut images = Vec::with_capacity(transitions.len());
        for transition in transitions {
            images.push(
                vk::ImageMemoryBarrier2::default()
                    .src_stage_mask(barrier.src_stage_mask)
                    .src_access_mask(barrier.src_access_mask)
                    .dst_stage_mask(barrier.dst_stage_mask)
                    .dst_access_mask(barrier.dst_access_mask)
                    .old_layout(layout(transition.from))
                    .new_layout(layout(transition.to))
                    .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                    .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                    .image(self.image_memory(transition.image)?.0.raw)
                    .subresource_range(WHOLE),
            );
        }
        let barriers = [*barrier];
        let info = vk::DependencyInfo::default().memory_barriers(&barriers).image_memory_barriers(&images);
        // SAFETY: the command buffer is being recorded; the images are alive and in the layouts that the plan and the
        // caller that bound them promise.
        unsafe { self.device.0.raw.cmd_pipeline_barrier2(commands, &info) };
        Ok(())
    }

    /// Returns the layout of an image between entry and exit.
    fn home(&self, image: Image) -> vk::ImageLayout {
        layout(self.plan.homes[image.index()].unwrap_or(ImageState::General))
    }

    /// Opens a label for capture tools and messages. [`Executor::close_label`] closes it.
    fn open_label(&self, commands: vk::CommandBuffer, name: &str) {
        let shared = &self.device.0;
        if shared.instance.validation {
            shared.instance.messages.open(name);
        }
        let Some(labels) = &shared.labels else { return };
        let name = std::ffi::CString::new(name).unwrap_or_default();
        let label = vk::DebugUtilsLabelEXT::default().label_name(&name);
        // SAFETY: the command buffer is being recorded; labels are opened and closed in pairs.
        unsafe { labels.cmd_begin_debug_utils_label(commands, &label) };
    }

    fn close_label(&self, commands: vk::CommandBuffer) {
        let shared = &self.device.0;
        if shared.instance.validation {
            shared.instance.messages.close();
        }
        let Some(labels) = &shared.labels else { return };
        // SAFETY: as above; a label is open.
        unsafe { labels.cmd_end_debug_utils_label(commands) };
    }

    pub(super) fn barrier(&self, commands: vk::CommandBuffer, barrier: &vk::MemoryBarrier2<'_>) {
        let barriers = [*barrier];
        let info = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: the command buffer is being recorded.
        unsafe { self.device.0.raw.cmd_pipeline_barrier2(commands, &info) };
    }

    fn stamp(&self, commands: vk::CommandBuffer, slot: &Slot, pass: usize, end: bool) {
        if slot.queries != vk::QueryPool::null() {
            let stage = vk::PipelineStageFlags2::ALL_COMMANDS;
            let query = 2 * pass as u32 + u32::from(end);
            // SAFETY: the pool has two queries for every pass, reset at the start of this command buffer.
            unsafe { self.device.0.raw.cmd_write_timestamp2(commands, stage, slot.queries, query) };
        }
    }
}

/// Returns the pipeline of a pass that runs a kernel.
fn wanted(pass: &PassKind) -> Option<Wanted<'_>> {
    match pass {
        PassKind::Compute { shader, specs, subgroup_size, .. } => Some((shader, specs, *subgroup_size)),
        _ => None,
    }
}

pub(super) fn everything() -> vk::MemoryBarrier2<'static> {
    let stages = vk::PipelineStageFlags2::COMPUTE_SHADER
        | vk::PipelineStageFlags2::ALL_TRANSFER
        | vk::PipelineStageFlags2::DRAW_INDIRECT;
    vk::MemoryBarrier2::default()
        .src_stage_mask(stages)
        .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
        .dst_stage_mask(stages)
        .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
}

/// Merges the scopes of two barriers.
fn merge(a: vk::MemoryBarrier2<'static>, b: vk::MemoryBarrier2<'static>) -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(a.src_stage_mask | b.src_stage_mask)
        .src_access_mask(a.src_access_mask | b.src_access_mask)
        .dst_stage_mask(a.dst_stage_mask | b.dst_stage_mask)
        .dst_access_mask(a.dst_access_mask | b.dst_access_mask)
}

/// Returns the Vulkan layout of a state.
fn layout(state: ImageState) -> vk::ImageLayout {
    match state {
        ImageState::Undefined => vk::ImageLayout::UNDEFINED,
        ImageState::General => vk::ImageLayout::GENERAL,
        ImageState::TransferSource => vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
        ImageState::TransferTarget => vk::ImageLayout::TRANSFER_DST_OPTIMAL,
        ImageState::ShaderRead => vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
        ImageState::ColorAttachment => vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
        ImageState::Present => vk::ImageLayout::PRESENT_SRC_KHR,
    }
}

pub(super) fn translate(barrier: &Barrier) -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(stages(barrier.src_stage))
        .src_access_mask(accesses(barrier.src_access))
        .dst_stage_mask(stages(barrier.dst_stage))
        .dst_access_mask(accesses(barrier.dst_access))
}

fn stages(s: Stages) -> vk::PipelineStageFlags2 {
    let table = [
        (Stages::COMPUTE, vk::PipelineStageFlags2::COMPUTE_SHADER),
        (Stages::INDIRECT, vk::PipelineStageFlags2::DRAW_INDIRECT),
        (Stages::TRANSFER, vk::PipelineStageFlags2::ALL_TRANSFER),
        (Stages::HOST, vk::PipelineStageFlags2::HOST),
        (Stages::OUTSIDE, vk::PipelineStageFlags2::ALL_COMMANDS),
    ];
    table.into_iter().filter(|(f, _)| s.contains(*f)).fold(vk::PipelineStageFlags2::NONE, |a, (_, f)| a | f)
}

fn accesses(a: Accesses) -> vk::AccessFlags2 {
    let table = [
        (Accesses::STORAGE_READ, vk::AccessFlags2::SHADER_STORAGE_READ),
        (Accesses::STORAGE_WRITE, vk::AccessFlags2::SHADER_STORAGE_WRITE),
        (Accesses::UNIFORM_READ, vk::AccessFlags2::UNIFORM_READ),
        (Accesses::INDIRECT_READ, vk::AccessFlags2::INDIRECT_COMMAND_READ),
        (Accesses::TRANSFER_READ, vk::AccessFlags2::TRANSFER_READ),
        (Accesses::TRANSFER_WRITE, vk::AccessFlags2::TRANSFER_WRITE),
        (Accesses::HOST_READ, vk::AccessFlags2::HOST_READ),
        (Accesses::OUTSIDE_READ, vk::AccessFlags2::MEMORY_READ),
        (Accesses::OUTSIDE_WRITE, vk::AccessFlags2::MEMORY_WRITE),
    ];
    table.into_iter().filter(|(f, _)| a.contains(*f)).fold(vk::AccessFlags2::NONE, |x, (_, f)| x | f)
}

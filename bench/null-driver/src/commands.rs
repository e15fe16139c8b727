//! Command buffers, submissions and semaphores.

use crate::counters::Counter;
use crate::handles::{
    Commands, Device, Queue, array, count, destroy, destroy_plain, dispatchable, given, object, plain, plain_object,
    put,
};
use crate::memory::Buffer;
use ash::vk;
use std::sync::atomic::{AtomicU64, Ordering};

type Callbacks<'a> = *const vk::AllocationCallbacks<'a>;

/// Transfer of a command buffer that is submitted once.
pub(crate) enum Transfer {
    Copy { from: vk::Buffer, to: vk::Buffer, region: vk::BufferCopy },
    Fill { buffer: vk::Buffer, offset: u64, bytes: u64, word: u32 },
}

impl Transfer {
    /// Executes the transfer. Returns its bytes.
    fn run(&self) -> u64 {
        match *self {
            Transfer::Copy { from, to, region: vk::BufferCopy { src_offset, dst_offset, size } } => {
                let from = plain_object::<_, Buffer>(from).range(src_offset, size);
                let to = plain_object::<_, Buffer>(to).range(dst_offset, size);
                let (Some(from), Some(to)) = (from, to) else { return 0 };
                // SAFETY: both ranges lie inside bound buffers, whose memory is alive; they may overlap.
                unsafe { std::ptr::copy(from, to, size as usize) };
                size
            }
            Transfer::Fill { buffer, offset, bytes, word } => {
                let buffer = plain_object::<_, Buffer>(buffer);
                let words = if bytes == vk::WHOLE_SIZE { buffer.rest(offset) } else { bytes } / 4;
                let Some(start) = buffer.range(offset, 4 * words) else { return 0 };
                for i in 0..words as usize {
                    // SAFETY: the word lies inside a bound buffer, whose memory is alive.
                    unsafe { start.cast::<u32>().add(i).write_unaligned(word) };
                }
                4 * words
            }
        }
    }
}

/// Pool with its command buffers.
struct Pool(Vec<vk::CommandBuffer>);

pub(crate) extern "system" fn create_pool(
    device: vk::Device,
    _: *const vk::CommandPoolCreateInfo<'_>,
    _: Callbacks<'_>,
    pool: *mut vk::CommandPool,
) -> vk::Result {
    count(device, Counter::Objects, 1);
    put(pool, plain(Pool(Vec::new())));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_pool(_: vk::Device, pool: vk::CommandPool, _: Callbacks<'_>) {
    if pool != vk::CommandPool::null() {
        plain_object::<_, Pool>(pool).0.drain(..).for_each(destroy::<_, Commands>);
        destroy_plain::<_, Pool>(pool);
    }
}

pub(crate) extern "system" fn reset_pool(
    _: vk::Device,
    _: vk::CommandPool,
    _: vk::CommandPoolResetFlags,
) -> vk::Result {
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn allocate(
    device: vk::Device,
    info: *const vk::CommandBufferAllocateInfo<'_>,
    into: *mut vk::CommandBuffer,
) -> vk::Result {
    let info = given(info);
    let pool = plain_object::<_, Pool>(info.command_pool);
    for i in 0..info.command_buffer_count as usize {
        let counters = object::<_, Device>(device).counters.clone();
        let commands = dispatchable(Commands { counters, once: false, transfers: Vec::new() });
        pool.0.push(commands);
        put(into.wrapping_add(i), commands);
    }
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn free(
    _: vk::Device,
    pool: vk::CommandPool,
    number: u32,
    buffers: *const vk::CommandBuffer,
) {
    let freed = array(buffers, number);
    plain_object::<_, Pool>(pool).0.retain(|buffer| !freed.contains(buffer));
    freed.iter().for_each(|buffer| destroy::<_, Commands>(*buffer));
}

pub(crate) extern "system" fn begin(
    commands: vk::CommandBuffer,
    info: *const vk::CommandBufferBeginInfo<'_>,
) -> vk::Result {
    let commands = object::<_, Commands>(commands);
    commands.counters.add(Counter::Recordings, 1);
    commands.once = given(info).flags.contains(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
    commands.transfers.clear();
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn end(_: vk::CommandBuffer) -> vk::Result {
    vk::Result::SUCCESS
}

fn command(commands: vk::CommandBuffer) -> &'static mut Commands {
    let commands = object::<_, Commands>(commands);
    commands.counters.add(Counter::Commands, 1);
    commands
}

pub(crate) extern "system" fn copy_buffer(
    commands: vk::CommandBuffer,
    from: vk::Buffer,
    to: vk::Buffer,
    number: u32,
    regions: *const vk::BufferCopy,
) {
    let commands = command(commands);
    if commands.once {
        commands.transfers.extend(array(regions, number).iter().map(|region| Transfer::Copy {
            from,
            to,
            region: *region,
        }));
    }
}

pub(crate) extern "system" fn fill_buffer(
    commands: vk::CommandBuffer,
    buffer: vk::Buffer,
    offset: u64,
    bytes: u64,
    word: u32,
) {
    let commands = command(commands);
    if commands.once {
        commands.transfers.push(Transfer::Fill { buffer, offset, bytes, word });
    }
}

pub(crate) extern "system" fn copy_image(
    commands: vk::CommandBuffer,
    _: vk::Image,
    _: vk::ImageLayout,
    _: vk::Image,
    _: vk::ImageLayout,
    _: u32,
    _: *const vk::ImageCopy,
) {
    command(commands);
}

pub(crate) extern "system" fn copy_image_to_buffer(
    commands: vk::CommandBuffer,
    _: vk::Image,
    _: vk::ImageLayout,
    _: vk::Buffer,
    _: u32,
    _: *const vk::BufferImageCopy,
) {
    command(commands);
}

pub(crate) extern "system" fn copy_buffer_to_image(
    commands: vk::CommandBuffer,
    _: vk::Buffer,
    _: vk::Image,
    _: vk::ImageLayout,
    _: u32,
    _: *const vk::BufferImageCopy,
) {
    command(commands);
}

pub(crate) extern "system" fn clear_color_image(
    commands: vk::CommandBuffer,
    _: vk::Image,
    _: vk::ImageLayout,
    _: *const vk::ClearColorValue,
    _: u32,
    _: *const vk::ImageSubresourceRange,
) {
    command(commands);
}

pub(crate) extern "system" fn bind_pipeline(commands: vk::CommandBuffer, _: vk::PipelineBindPoint, _: vk::Pipeline) {
    command(commands);
}

pub(crate) extern "system" fn bind_sets(
    commands: vk::CommandBuffer,
    _: vk::PipelineBindPoint,
    _: vk::PipelineLayout,
    _: u32,
    _: u32,
    _: *const vk::DescriptorSet,
    _: u32,
    _: *const u32,
) {
    command(commands);
}

pub(crate) extern "system" fn push_constants(
    commands: vk::CommandBuffer,
    _: vk::PipelineLayout,
    _: vk::ShaderStageFlags,
    _: u32,
    _: u32,
    _: *const std::ffi::c_void,
) {
    command(commands);
}

pub(crate) extern "system" fn dispatch(commands: vk::CommandBuffer, _: u32, _: u32, _: u32) {
    command(commands);
}

pub(crate) extern "system" fn dispatch_indirect(commands: vk::CommandBuffer, _: vk::Buffer, _: u64) {
    command(commands);
}

pub(crate) extern "system" fn barrier(commands: vk::CommandBuffer, _: *const vk::DependencyInfo<'_>) {
    command(commands);
}

pub(crate) extern "system" fn write_timestamp(
    commands: vk::CommandBuffer,
    _: vk::PipelineStageFlags2,
    _: vk::QueryPool,
    _: u32,
) {
    command(commands);
}

pub(crate) extern "system" fn reset_queries(commands: vk::CommandBuffer, _: vk::QueryPool, _: u32, _: u32) {
    command(commands);
}

pub(crate) extern "system" fn begin_label(commands: vk::CommandBuffer, _: *const vk::DebugUtilsLabelEXT<'_>) {
    command(commands);
}

pub(crate) extern "system" fn end_label(commands: vk::CommandBuffer) {
    command(commands);
}

pub(crate) extern "system" fn submit(
    queue: vk::Queue,
    number: u32,
    submits: *const vk::SubmitInfo2<'_>,
    _: vk::Fence,
) -> vk::Result {
    let Queue { counters, family } = object::<_, Queue>(queue);
    counters.add(if *family == 0 { Counter::Submits } else { Counter::TransferSubmits }, 1);
    for submit in array(submits, number) {
        for info in array(submit.p_command_buffer_infos, submit.command_buffer_info_count) {
            let commands = object::<_, Commands>(info.command_buffer);
            if !commands.transfers.is_empty() {
                counters.add(Counter::TransferBytes, commands.transfers.iter().map(Transfer::run).sum());
            }
        }
        for signal in array(submit.p_signal_semaphore_infos, submit.signal_semaphore_info_count) {
            // Work is done in the order of its submission, so that no semaphore needs a wait.
            plain_object::<_, AtomicU64>(signal.semaphore).fetch_max(signal.value, Ordering::Release);
        }
    }
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn queue_idle(_: vk::Queue) -> vk::Result {
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn device_idle(_: vk::Device) -> vk::Result {
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn create_semaphore(
    device: vk::Device,
    _: *const vk::SemaphoreCreateInfo<'_>,
    _: Callbacks<'_>,
    semaphore: *mut vk::Semaphore,
) -> vk::Result {
    count(device, Counter::Objects, 1);
    put(semaphore, plain(AtomicU64::new(0)));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_semaphore(_: vk::Device, semaphore: vk::Semaphore, _: Callbacks<'_>) {
    destroy_plain::<_, AtomicU64>(semaphore);
}

pub(crate) extern "system" fn semaphore_value(_: vk::Device, semaphore: vk::Semaphore, value: *mut u64) -> vk::Result {
    put(value, plain_object::<_, AtomicU64>(semaphore).load(Ordering::Acquire));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn wait(
    device: vk::Device,
    info: *const vk::SemaphoreWaitInfo<'_>,
    _nanoseconds: u64,
) -> vk::Result {
    count(device, Counter::Waits, 1);
    let info = given(info);
    let values = array(info.p_values, info.semaphore_count);
    let done = |(semaphore, value): (&vk::Semaphore, &u64)| {
        plain_object::<_, AtomicU64>(*semaphore).load(Ordering::Acquire) >= *value
    };
    let semaphores = array(info.p_semaphores, info.semaphore_count);
    // Nothing runs that could signal them later.
    if semaphores.iter().zip(values).all(done) { vk::Result::SUCCESS } else { vk::Result::TIMEOUT }
}

pub(crate) extern "system" fn signal(_: vk::Device, info: *const vk::SemaphoreSignalInfo<'_>) -> vk::Result {
    let info = given(info);
    plain_object::<_, AtomicU64>(info.semaphore).fetch_max(info.value, Ordering::Release);
    vk::Result::SUCCESS
}

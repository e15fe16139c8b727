//! Instance, device, and objects without content.

use crate::counters::{Counter, Counters};
use crate::handles::{
    Device, Instance, Physical, Queue, array, count, destroy, dispatchable, given, list, object, put,
};
use ash::vk::{self, Handle};
use std::ffi::{CStr, c_char, c_void};

type Callbacks<'a> = *const vk::AllocationCallbacks<'a>;

pub(crate) extern "system" fn instance_extensions(
    _: *const c_char,
    number: *mut u32,
    into: *mut vk::ExtensionProperties,
) -> vk::Result {
    list(&[], number, into)
}

pub(crate) extern "system" fn instance_version(version: *mut u32) -> vk::Result {
    put(version, crate::describe::VERSION);
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn create_instance(
    _: *const vk::InstanceCreateInfo<'_>,
    _: Callbacks<'_>,
    instance: *mut vk::Instance,
) -> vk::Result {
    let physical = dispatchable(Physical { counters: Counters::open() });
    put(instance, dispatchable(Instance { physical }));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_instance(instance: vk::Instance, _: Callbacks<'_>) {
    if instance != vk::Instance::null() {
        destroy::<_, Physical>(object::<_, Instance>(instance).physical);
        destroy::<_, Instance>(instance);
    }
}

pub(crate) extern "system" fn physical_devices(
    instance: vk::Instance,
    number: *mut u32,
    into: *mut vk::PhysicalDevice,
) -> vk::Result {
    list(&[object::<_, Instance>(instance).physical], number, into)
}

pub(crate) extern "system" fn device_extensions(
    _: vk::PhysicalDevice,
    _: *const c_char,
    number: *mut u32,
    into: *mut vk::ExtensionProperties,
) -> vk::Result {
    list(&[], number, into)
}

pub(crate) extern "system" fn device_layers(
    _: vk::PhysicalDevice,
    number: *mut u32,
    into: *mut vk::LayerProperties,
) -> vk::Result {
    list(&[], number, into)
}

pub(crate) extern "system" fn create_device(
    physical: vk::PhysicalDevice,
    _: *const vk::DeviceCreateInfo<'_>,
    _: Callbacks<'_>,
    device: *mut vk::Device,
) -> vk::Result {
    let counters = object::<_, Physical>(physical).counters.clone();
    let queues = [0, 1].map(|family| dispatchable(Queue { counters: counters.clone(), family }));
    put(device, dispatchable(Device { counters, queues }));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_device(device: vk::Device, _: Callbacks<'_>) {
    if device != vk::Device::null() {
        object::<_, Device>(device).queues.into_iter().for_each(destroy::<_, Queue>);
        destroy::<_, Device>(device);
    }
}

pub(crate) extern "system" fn queue(device: vk::Device, family: u32, _index: u32, into: *mut vk::Queue) {
    put(into, object::<_, Device>(device).queues[family as usize]);
}

pub(crate) extern "system" fn queue2(device: vk::Device, info: *const vk::DeviceQueueInfo2<'_>, into: *mut vk::Queue) {
    queue(device, given(info).queue_family_index, 0, into);
}

pub(crate) extern "system" fn address_in_instance(_: vk::Instance, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: the caller of Vulkan promises a valid C string.
    crate::table::address(unsafe { CStr::from_ptr(name) })
}

pub(crate) extern "system" fn address_in_device(_: vk::Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: as above.
    crate::table::address(unsafe { CStr::from_ptr(name) })
}

/// Makes a handle of an object without content. It differs from all handles of the device that are alive.
fn empty<H: Handle>(device: vk::Device, into: *mut H) {
    count(device, Counter::Objects, 1);
    put(into, crate::handles::plain(0u64));
}

/// Defines functions that create and destroy objects without content.
macro_rules! empty_objects {
    ($($create:ident, $destroy:ident, $info:ty, $handle:ty;)*) => {$(
        pub(crate) extern "system" fn $create(
            device: vk::Device,
            _: *const $info,
            _: Callbacks<'_>,
            into: *mut $handle,
        ) -> vk::Result {
            empty(device, into);
            vk::Result::SUCCESS
        }

        pub(crate) extern "system" fn $destroy(_: vk::Device, handle: $handle, _: Callbacks<'_>) {
            crate::handles::destroy_plain::<_, u64>(handle);
        }
    )*};
}

empty_objects! {
    create_shader, destroy_shader, vk::ShaderModuleCreateInfo<'_>, vk::ShaderModule;
    create_set_layout, destroy_set_layout, vk::DescriptorSetLayoutCreateInfo<'_>, vk::DescriptorSetLayout;
    create_layout, destroy_layout, vk::PipelineLayoutCreateInfo<'_>, vk::PipelineLayout;
    create_cache, destroy_cache, vk::PipelineCacheCreateInfo<'_>, vk::PipelineCache;
    create_query_pool, destroy_query_pool, vk::QueryPoolCreateInfo<'_>, vk::QueryPool;
    create_view, destroy_view, vk::ImageViewCreateInfo<'_>, vk::ImageView;
    create_fence, destroy_fence, vk::FenceCreateInfo<'_>, vk::Fence;
}

pub(crate) extern "system" fn create_pipelines(
    device: vk::Device,
    _: vk::PipelineCache,
    number: u32,
    _: *const vk::ComputePipelineCreateInfo<'_>,
    _: Callbacks<'_>,
    into: *mut vk::Pipeline,
) -> vk::Result {
    (0..number as usize).for_each(|i| empty(device, into.wrapping_add(i)));
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_pipeline(_: vk::Device, pipeline: vk::Pipeline, _: Callbacks<'_>) {
    crate::handles::destroy_plain::<_, u64>(pipeline);
}

pub(crate) extern "system" fn cache_data(
    _: vk::Device,
    _: vk::PipelineCache,
    bytes: *mut usize,
    _: *mut c_void,
) -> vk::Result {
    put(bytes, 0);
    vk::Result::SUCCESS
}

/// Pool with its sets.
struct Sets(Vec<vk::DescriptorSet>);

pub(crate) extern "system" fn create_sets(
    device: vk::Device,
    _: *const vk::DescriptorPoolCreateInfo<'_>,
    _: Callbacks<'_>,
    pool: *mut vk::DescriptorPool,
) -> vk::Result {
    count(device, Counter::Objects, 1);
    put(pool, crate::handles::plain(Sets(Vec::new())));
    vk::Result::SUCCESS
}

fn free_sets(pool: vk::DescriptorPool) {
    let Sets(sets) = crate::handles::plain_object(pool);
    sets.drain(..).for_each(crate::handles::destroy_plain::<_, u64>);
}

pub(crate) extern "system" fn reset_sets(
    _: vk::Device,
    pool: vk::DescriptorPool,
    _: vk::DescriptorPoolResetFlags,
) -> vk::Result {
    free_sets(pool);
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn destroy_sets(_: vk::Device, pool: vk::DescriptorPool, _: Callbacks<'_>) {
    if pool != vk::DescriptorPool::null() {
        free_sets(pool);
        crate::handles::destroy_plain::<_, Sets>(pool);
    }
}

pub(crate) extern "system" fn allocate_sets(
    device: vk::Device,
    info: *const vk::DescriptorSetAllocateInfo<'_>,
    into: *mut vk::DescriptorSet,
) -> vk::Result {
    let info = given(info);
    for i in 0..info.descriptor_set_count as usize {
        let set = into.wrapping_add(i);
        empty(device, set);
        let Sets(sets) = crate::handles::plain_object(info.descriptor_pool);
        sets.push(*given(set));
    }
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn update_sets(
    device: vk::Device,
    writes: u32,
    infos: *const vk::WriteDescriptorSet<'_>,
    _: u32,
    _: *const vk::CopyDescriptorSet<'_>,
) {
    let descriptors: u32 = array(infos, writes).iter().map(|write| write.descriptor_count).sum();
    count(device, Counter::Descriptors, u64::from(descriptors));
}

pub(crate) extern "system" fn reset_query_pool(_: vk::Device, _: vk::QueryPool, _: u32, _: u32) {}

pub(crate) extern "system" fn query_results(
    _: vk::Device,
    _: vk::QueryPool,
    _first: u32,
    _number: u32,
    _bytes: usize,
    _: *mut c_void,
    _: u64,
    _: vk::QueryResultFlags,
) -> vk::Result {
    vk::Result::NOT_READY
}

pub(crate) extern "system" fn fences_done(_: vk::Device, _: u32, _: *const vk::Fence) -> vk::Result {
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn wait_fences(
    _: vk::Device,
    _: u32,
    _: *const vk::Fence,
    _: vk::Bool32,
    _: u64,
) -> vk::Result {
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn set_name(_: vk::Device, _: *const vk::DebugUtilsObjectNameInfoEXT<'_>) -> vk::Result {
    vk::Result::SUCCESS
}

//! Properties and features of the device.

use crate::handles::{given, list, put};
use ash::vk::{self, TaggedStructure};
use std::ffi::{CStr, c_char};

/// Version of the API.
pub(crate) const VERSION: u32 = vk::make_api_version(0, 1, 3, 250);

/// Lanes of a subgroup.
const LANES: u32 = 32;

/// Bytes of device memory.
const HEAP: u64 = 16 << 30;

/// Largest buffer and allocation.
const MOST: u64 = 4 << 30;

fn text(words: &CStr, into: &mut [c_char]) {
    for (place, byte) in into.iter_mut().zip(words.to_bytes_with_nul()) {
        *place = *byte as c_char;
    }
}

/// Calls `with` for each struct of a chain.
fn each(mut next: *mut std::ffi::c_void, mut with: impl FnMut(vk::StructureType, *mut std::ffi::c_void)) {
    while !next.is_null() {
        let head = given(next.cast::<vk::BaseOutStructure<'_>>().cast_const());
        with(head.s_type, next);
        next = head.p_next.cast();
    }
}

/// Changes the struct of a chain if it has this type.
fn change<T: TaggedStructure>(kind: vk::StructureType, at: *mut std::ffi::c_void, with: impl FnOnce(&mut T)) {
    if kind == T::STRUCTURE_TYPE {
        // SAFETY: the type in its first word says that the struct is of this type, as the caller of Vulkan promises.
        with(unsafe { &mut *at.cast::<T>() });
    }
}

fn limits() -> vk::PhysicalDeviceLimits {
    let many = 1 << 20;
    vk::PhysicalDeviceLimits {
        max_image_dimension1_d: 16384,
        max_image_dimension2_d: 16384,
        max_image_dimension3_d: 2048,
        max_image_dimension_cube: 16384,
        max_image_array_layers: 2048,
        max_uniform_buffer_range: 65536,
        max_storage_buffer_range: u32::MAX,
        max_push_constants_size: 256,
        max_memory_allocation_count: u32::MAX,
        max_sampler_allocation_count: many,
        buffer_image_granularity: 1,
        max_bound_descriptor_sets: 8,
        max_per_stage_descriptor_samplers: many,
        max_per_stage_descriptor_uniform_buffers: many,
        max_per_stage_descriptor_storage_buffers: many,
        max_per_stage_descriptor_sampled_images: many,
        max_per_stage_descriptor_storage_images: many,
        max_per_stage_resources: many,
        max_descriptor_set_samplers: many,
        max_descriptor_set_uniform_buffers: many,
        max_descriptor_set_storage_buffers: many,
        max_descriptor_set_sampled_images: many,
        max_descriptor_set_storage_images: many,
        max_compute_shared_memory_size: 49152,
        max_compute_work_group_count: [i32::MAX as u32, 65535, 65535],
        max_compute_work_group_invocations: 1024,
        max_compute_work_group_size: [1024, 1024, 64],
        min_memory_map_alignment: 64,
        min_texel_buffer_offset_alignment: 16,
        min_uniform_buffer_offset_alignment: 64,
        min_storage_buffer_offset_alignment: 16,
        framebuffer_color_sample_counts: vk::SampleCountFlags::TYPE_1,
        storage_image_sample_counts: vk::SampleCountFlags::TYPE_1,
        timestamp_period: 1.0,
        optimal_buffer_copy_offset_alignment: 1,
        optimal_buffer_copy_row_pitch_alignment: 1,
        non_coherent_atom_size: 64,
        ..Default::default()
    }
}

pub(crate) extern "system" fn properties(_: vk::PhysicalDevice, into: *mut vk::PhysicalDeviceProperties) {
    let mut properties = vk::PhysicalDeviceProperties {
        api_version: VERSION,
        driver_version: 1,
        vendor_id: 0x1_0005,
        device_id: 0,
        device_type: vk::PhysicalDeviceType::DISCRETE_GPU,
        limits: limits(),
        ..Default::default()
    };
    text(c"null driver", &mut properties.device_name);
    put(into, properties);
}

pub(crate) extern "system" fn properties2(physical: vk::PhysicalDevice, into: *mut vk::PhysicalDeviceProperties2<'_>) {
    // SAFETY: the caller of Vulkan passes a struct that may be changed.
    let into = unsafe { &mut *into };
    properties(physical, &raw mut into.properties);
    let stages = vk::ShaderStageFlags::COMPUTE;
    use vk::SubgroupFeatureFlags as Of;
    let operations =
        Of::BASIC | Of::VOTE | Of::ARITHMETIC | Of::BALLOT | Of::SHUFFLE | Of::SHUFFLE_RELATIVE | Of::CLUSTERED;
    each(into.p_next, |kind, at| {
        change(kind, at, |p: &mut vk::PhysicalDeviceSubgroupProperties<'_>| {
            (p.subgroup_size, p.supported_stages, p.supported_operations) = (LANES, stages, operations);
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceVulkan11Properties<'_>| {
            (p.subgroup_size, p.subgroup_supported_stages) = (LANES, stages);
            (p.subgroup_supported_operations, p.max_memory_allocation_size) = (operations, MOST);
            p.max_per_set_descriptors = 1 << 20;
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceVulkan12Properties<'_>| {
            p.max_timeline_semaphore_value_difference = u64::MAX;
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceTimelineSemaphoreProperties<'_>| {
            p.max_timeline_semaphore_value_difference = u64::MAX;
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceVulkan13Properties<'_>| {
            (p.min_subgroup_size, p.max_subgroup_size) = (LANES, LANES);
            (p.max_compute_workgroup_subgroups, p.required_subgroup_size_stages) = (32, stages);
            p.max_buffer_size = MOST;
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceSubgroupSizeControlProperties<'_>| {
            (p.min_subgroup_size, p.max_subgroup_size) = (LANES, LANES);
            (p.max_compute_workgroup_subgroups, p.required_subgroup_size_stages) = (32, stages);
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceDriverProperties<'_>| {
            text(c"null driver", &mut p.driver_name);
            text(c"runs no kernels", &mut p.driver_info);
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceMaintenance3Properties<'_>| {
            (p.max_memory_allocation_size, p.max_per_set_descriptors) = (MOST, 1 << 20);
        });
        change(kind, at, |p: &mut vk::PhysicalDeviceMaintenance4Properties<'_>| p.max_buffer_size = MOST);
    });
}

pub(crate) extern "system" fn features(_: vk::PhysicalDevice, into: *mut vk::PhysicalDeviceFeatures) {
    put(into, vk::PhysicalDeviceFeatures { shader_int64: vk::TRUE, ..Default::default() });
}

pub(crate) extern "system" fn features2(physical: vk::PhysicalDevice, into: *mut vk::PhysicalDeviceFeatures2<'_>) {
    // SAFETY: as in `properties2`.
    let into = unsafe { &mut *into };
    features(physical, &raw mut into.features);
    each(into.p_next, |kind, at| {
        change(kind, at, |f: &mut vk::PhysicalDeviceVulkan12Features<'_>| {
            (f.timeline_semaphore, f.scalar_block_layout, f.host_query_reset) = (vk::TRUE, vk::TRUE, vk::TRUE);
        });
        change(kind, at, |f: &mut vk::PhysicalDeviceTimelineSemaphoreFeatures<'_>| f.timeline_semaphore = vk::TRUE);
        change(kind, at, |f: &mut vk::PhysicalDeviceVulkan13Features<'_>| {
            (f.synchronization2, f.maintenance4) = (vk::TRUE, vk::TRUE);
            (f.subgroup_size_control, f.compute_full_subgroups) = (vk::TRUE, vk::TRUE);
        });
    });
}

pub(crate) extern "system" fn format_properties(_: vk::PhysicalDevice, _: vk::Format, into: *mut vk::FormatProperties) {
    use vk::FormatFeatureFlags as Of;
    let all = Of::STORAGE_IMAGE | Of::SAMPLED_IMAGE | Of::TRANSFER_SRC | Of::TRANSFER_DST;
    put(into, vk::FormatProperties { optimal_tiling_features: all, ..Default::default() });
}

pub(crate) extern "system" fn image_format_properties(
    _: vk::PhysicalDevice,
    _: vk::Format,
    _: vk::ImageType,
    _: vk::ImageTiling,
    _: vk::ImageUsageFlags,
    _: vk::ImageCreateFlags,
    into: *mut vk::ImageFormatProperties,
) -> vk::Result {
    let properties = vk::ImageFormatProperties {
        max_extent: vk::Extent3D { width: 16384, height: 16384, depth: 2048 },
        max_mip_levels: 15,
        max_array_layers: 2048,
        sample_counts: vk::SampleCountFlags::TYPE_1,
        max_resource_size: MOST,
    };
    put(into, properties);
    vk::Result::SUCCESS
}

pub(crate) extern "system" fn sparse_properties(
    _: vk::PhysicalDevice,
    _: vk::Format,
    _: vk::ImageType,
    _: vk::SampleCountFlags,
    _: vk::ImageUsageFlags,
    _: vk::ImageTiling,
    number: *mut u32,
    into: *mut vk::SparseImageFormatProperties,
) {
    let _complete = list(&[], number, into);
}

pub(crate) extern "system" fn families(_: vk::PhysicalDevice, number: *mut u32, into: *mut vk::QueueFamilyProperties) {
    let family = |queue_flags| vk::QueueFamilyProperties {
        queue_flags,
        queue_count: 1,
        min_image_transfer_granularity: vk::Extent3D { width: 1, height: 1, depth: 1 },
        ..Default::default()
    };
    let all = [family(vk::QueueFlags::COMPUTE | vk::QueueFlags::TRANSFER), family(vk::QueueFlags::TRANSFER)];
    let _complete = list(&all, number, into);
}

pub(crate) extern "system" fn families2(
    physical: vk::PhysicalDevice,
    number: *mut u32,
    into: *mut vk::QueueFamilyProperties2<'_>,
) {
    let mut all = [vk::QueueFamilyProperties::default(); 2];
    let mut most = 2;
    families(physical, &raw mut most, all.as_mut_ptr());
    if into.is_null() {
        put(number, 2);
        return;
    }
    let written = most.min(*given(number));
    for (i, family) in all.into_iter().take(written as usize).enumerate() {
        // SAFETY: the caller of Vulkan passes an array of that length, which may be changed.
        unsafe { (*into.add(i)).queue_family_properties = family };
    }
    put(number, written);
}

pub(crate) extern "system" fn memory_properties(_: vk::PhysicalDevice, into: *mut vk::PhysicalDeviceMemoryProperties) {
    use vk::MemoryPropertyFlags as Of;
    let mut properties =
        vk::PhysicalDeviceMemoryProperties { memory_type_count: 3, memory_heap_count: 2, ..Default::default() };
    let host = Of::HOST_VISIBLE | Of::HOST_COHERENT;
    let kind = |property_flags, heap_index| vk::MemoryType { property_flags, heap_index };
    properties.memory_types[0] = kind(Of::DEVICE_LOCAL, 0);
    properties.memory_types[1] = kind(host, 1);
    properties.memory_types[2] = kind(host | Of::HOST_CACHED, 1);
    properties.memory_heaps[0] = vk::MemoryHeap { size: HEAP, flags: vk::MemoryHeapFlags::DEVICE_LOCAL };
    properties.memory_heaps[1] = vk::MemoryHeap { size: HEAP, flags: vk::MemoryHeapFlags::empty() };
    put(into, properties);
}

pub(crate) extern "system" fn memory_properties2(
    physical: vk::PhysicalDevice,
    into: *mut vk::PhysicalDeviceMemoryProperties2<'_>,
) {
    // SAFETY: as in `properties2`.
    let into = unsafe { &mut *into };
    memory_properties(physical, &raw mut into.memory_properties);
}

//! Enumeration of physical devices, and queries of their properties.

use super::fault::Gate;
use super::identity::uuid_text;
use super::info::{DeviceInfo, MatrixShape, OptionalFeatures};
use super::instance::Instance;
use super::transfer_queue;
use crate::error::Result;
use crate::format::ImageFormat;
use ash::vk;

/// First version of the validation layer that knows `VK_KHR_cooperative_matrix`.
const COOPERATIVE_MATRIX_LAYER: (u32, u32, u32) = (1, 3, 255);

pub(crate) struct Candidate {
    pub physical: vk::PhysicalDevice,
    pub queue_family: Option<u32>,
    /// Family of queues that only transfer.
    pub transfer_family: Option<u32>,
    pub info: DeviceInfo,
}

pub(crate) fn candidates(instance: &Instance, gate: &Gate) -> Result<Vec<Candidate>> {
    // SAFETY: the instance is alive.
    let physicals =
        gate.call("vkEnumeratePhysicalDevices", "instance", || unsafe { instance.raw.enumerate_physical_devices() })?;
    physicals.into_iter().enumerate().map(|(index, p)| describe(instance, gate, index, p)).collect()
}

fn describe(instance: &Instance, gate: &Gate, index: usize, physical: vk::PhysicalDevice) -> Result<Candidate> {
    let api = &instance.raw;
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
    let mut atomics = vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default();
    let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
    let mut sizes = vk::PhysicalDeviceSubgroupSizeControlProperties::default();
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut allocation = vk::PhysicalDeviceMaintenance3Properties::default();
    let mut buffer = vk::PhysicalDeviceMaintenance4Properties::default();
    let mut identity = vk::PhysicalDeviceIDProperties::default();
    let mut bus = vk::PhysicalDevicePCIBusInfoPropertiesEXT::default();
    // SAFETY: the physical device comes from this instance. The version is queried first, because older devices do
    // not know the newer structs.
    let basic = unsafe { api.get_physical_device_properties(physical) };
    let modern = basic.api_version >= vk::API_VERSION_1_3;
    // SAFETY: as above.
    let extensions = gate.call("vkEnumerateDeviceExtensionProperties", "device", || unsafe {
        api.enumerate_device_extension_properties(physical)
    })?;
    let has = |name: &std::ffi::CStr| extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
    let has_bus = has(ash::ext::pci_bus_info::NAME);
    let has_atomics = has(ash::ext::shader_atomic_float::NAME);
    let has_cores = has(ash::amd::shader_core_properties::NAME);
    let has_multiprocessors = has(ash::nv::shader_sm_builtins::NAME);
    let mut cores = vk::PhysicalDeviceShaderCorePropertiesAMD::default();
    let mut multiprocessors = vk::PhysicalDeviceShaderSMBuiltinsPropertiesNV::default();
    let mut cooperative = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default();
    let mut cooperative_stages = vk::PhysicalDeviceCooperativeMatrixPropertiesKHR::default();
    // A validation layer reports structs of extensions that it does not know as errors.
    let layer_knows_matrices = instance.layer_version.is_none_or(|v| v >= COOPERATIVE_MATRIX_LAYER);
    let has_matrices = has(ash::khr::cooperative_matrix::NAME) && layer_knows_matrices;
    let mut properties = vk::PhysicalDeviceProperties2::default();
    if modern {
        properties = properties.push_next(&mut subgroup).push_next(&mut sizes).push_next(&mut driver);
        properties = properties.push_next(&mut allocation).push_next(&mut buffer).push_next(&mut identity);
        if has_bus {
            properties = properties.push_next(&mut bus);
        }
        if has_cores {
            properties = properties.push_next(&mut cores);
        }
        if has_multiprocessors {
            properties = properties.push_next(&mut multiprocessors);
        }
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut v12).push_next(&mut v13);
        if has_atomics {
            features = features.push_next(&mut atomics);
        }
        if has_matrices {
            features = features.push_next(&mut cooperative);
            properties = properties.push_next(&mut cooperative_stages);
        }
        // SAFETY: the chain holds structs that a 1.3 device with that extension knows.
        unsafe {
            api.get_physical_device_features2(physical, &mut features);
            api.get_physical_device_properties2(physical, &mut properties);
        }
    }
    // SAFETY: the physical device comes from this instance.
    let (families, memory) = unsafe {
        (api.get_physical_device_queue_family_properties(physical), api.get_physical_device_memory_properties(physical))
    };
    let queue_family = families.iter().position(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE));
    let timestamps = queue_family.is_some_and(|f| families[f].timestamp_valid_bits > 0);
    let storage_buffers =
        basic.limits.max_per_stage_descriptor_storage_buffers.min(basic.limits.max_descriptor_set_storage_buffers);
    let mut missing = Vec::new();
    let mut need = |present: bool, name: &str| {
        if !present {
            missing.push(name.to_owned());
        }
    };
    need(modern, "Vulkan 1.3");
    if modern {
        need(queue_family.is_some(), "a compute queue");
        need(v12.timeline_semaphore != 0, "timelineSemaphore");
        need(v12.scalar_block_layout != 0, "scalarBlockLayout");
        need(v12.host_query_reset != 0, "hostQueryReset");
        need(v13.synchronization2 != 0, "synchronization2");
        need(v13.maintenance4 != 0, "maintenance4");
        let operations = vk::SubgroupFeatureFlags::BASIC
            | vk::SubgroupFeatureFlags::VOTE
            | vk::SubgroupFeatureFlags::ARITHMETIC
            | vk::SubgroupFeatureFlags::BALLOT
            | vk::SubgroupFeatureFlags::SHUFFLE;
        need(
            subgroup.supported_operations.contains(operations)
                && subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE),
            "subgroup basic, vote, arithmetic, ballot and shuffle operations in compute",
        );
        need((8..=128).contains(&subgroup.subgroup_size), "a subgroup size between 8 and 128");
        let lanes = sizes.max_compute_workgroup_subgroups.saturating_mul(subgroup.subgroup_size);
        need(basic.limits.max_compute_work_group_invocations >= 256 && lanes >= 256, "workgroups of 256 invocations");
        need(basic.limits.max_compute_shared_memory_size >= 32768, "32 KiB of shared memory");
        need(storage_buffers >= 16, &format!("16 storage buffers per kernel (it allows {storage_buffers})"));
    }
    let subgroup_sizes = (sizes.min_subgroup_size, sizes.max_subgroup_size);
    let subgroup_size_control =
        v13.subgroup_size_control != 0 && sizes.required_subgroup_size_stages.contains(vk::ShaderStageFlags::COMPUTE);
    missing.extend(missing_size_control(subgroup_size_control, subgroup_sizes));
    let usable = modern
        && cooperative.cooperative_matrix != 0
        && v12.shader_float16 != 0
        && v12.vulkan_memory_model != 0
        && v12.vulkan_memory_model_device_scope != 0
        && cooperative_stages.cooperative_matrix_supported_stages.contains(vk::ShaderStageFlags::COMPUTE);
    let matrices = if usable { matrix_shapes(instance, gate, physical)? } else { Vec::new() };
    let optional = OptionalFeatures {
        float_atomics: has_atomics && atomics.shader_buffer_float32_atomic_add != 0,
        subgroup_size_control,
        full_subgroups: v13.compute_full_subgroups != 0,
        memory_budget: has(ash::ext::memory_budget::NAME),
        external_memory_fd: has(ash::khr::external_memory_fd::NAME),
        external_semaphore_fd: has(ash::khr::external_semaphore_fd::NAME),
        cooperative_matrix: !matrices.is_empty(),
    };
    let mut fallbacks = Vec::new();
    if !optional.float_atomics {
        fallbacks.push("shaderBufferFloat32AtomicAdd absent: gradients are reduced in order only".to_owned());
    }
    if !optional.subgroup_size_control {
        fallbacks.push("subgroupSizeControl absent: kernels run at the only subgroup size".to_owned());
    }
    if !optional.full_subgroups {
        fallbacks.push("computeFullSubgroups absent: kernels rely on the driver to fill subgroups".to_owned());
    }
    if !optional.memory_budget {
        fallbacks.push("VK_EXT_memory_budget absent: the budget is the size of the heap".to_owned());
    }
    if !layer_knows_matrices {
        fallbacks.push(
            "VK_KHR_cooperative_matrix unknown to this validation layer: matrices are multiplied by ordinary instructions"
                .to_owned(),
        );
    } else if matrices.is_empty() {
        fallbacks.push(
            "VK_KHR_cooperative_matrix absent: matrices are multiplied by ordinary instructions, in 32 bits".to_owned(),
        );
    }
    if !timestamps {
        fallbacks.push("timestamps absent: passes are not timed".to_owned());
    }
    let heaps = &memory.memory_heaps[..memory.memory_heap_count as usize];
    let limits = basic.limits;
    let text = |c: std::result::Result<&std::ffi::CStr, _>| {
        c.map_or_else(|_: std::ffi::FromBytesUntilNulError| String::new(), |c| c.to_string_lossy().into_owned())
    };
    let info = DeviceInfo {
        index,
        name: text(basic.device_name_as_c_str()),
        uuid: uuid_text(&identity.device_uuid),
        pci: (modern && has_bus).then(|| {
            format!("{:04x}:{:02x}:{:02x}.{:x}", bus.pci_domain, bus.pci_bus, bus.pci_device, bus.pci_function)
        }),
        vendor: basic.vendor_id,
        kind: match basic.device_type {
            vk::PhysicalDeviceType::DISCRETE_GPU => "discrete",
            vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated",
            vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual",
            vk::PhysicalDeviceType::CPU => "cpu",
            _ => "other",
        },
        driver: format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str())),
        api: format!(
            "{}.{}.{}",
            vk::api_version_major(basic.api_version),
            vk::api_version_minor(basic.api_version),
            vk::api_version_patch(basic.api_version)
        ),
        subgroup_size: subgroup.subgroup_size,
        subgroup_sizes,
        compute_units: compute_units(&cores, &multiprocessors),
        max_storage_range: u64::from(limits.max_storage_buffer_range),
        max_buffer: buffer.max_buffer_size,
        max_allocation: allocation.max_memory_allocation_size,
        max_shared_bytes: limits.max_compute_shared_memory_size,
        max_storage_buffers: storage_buffers,
        max_workgroup: limits.max_compute_work_group_invocations,
        storage_alignment: limits.min_storage_buffer_offset_alignment,
        uniform_alignment: limits.min_uniform_buffer_offset_alignment,
        max_image_size: limits.max_image_dimension2_d,
        storage_formats: storage_formats(instance, physical),
        timestamp_period: if timestamps { limits.timestamp_period } else { 0.0 },
        memory_bytes: heaps
            .iter()
            .filter(|h| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL))
            .map(|h| h.size)
            .sum(),
        matrices,
        missing,
        fallbacks,
        optional,
    };
    let transfer_family = transfer_queue::family(&families);
    Ok(Candidate { physical, queue_family: queue_family.map(|f| f as u32), transfer_family, info })
}

/// Returns the compute units, or multiprocessors, of a GPU.
///
/// Structs that the driver does not know are zero.
fn compute_units(
    amd: &vk::PhysicalDeviceShaderCorePropertiesAMD<'_>,
    nvidia: &vk::PhysicalDeviceShaderSMBuiltinsPropertiesNV<'_>,
) -> Option<u32> {
    let arrays = amd.shader_engine_count.saturating_mul(amd.shader_arrays_per_engine_count);
    Some(arrays.saturating_mul(amd.compute_units_per_shader_array).max(nvidia.shader_sm_count)).filter(|n| *n > 0)
}

/// Returns the missing subgroup size control of a device. `None` if the device has it, or has only one subgroup size.
///
/// Without control, a kernel may run at another size than it is specialized for.
pub(super) fn missing_size_control(control: bool, (low, high): (u32, u32)) -> Option<String> {
    (!control && low != high).then(|| {
        format!("subgroupSizeControl (its subgroups have {low} to {high} lanes, and each kernel needs one size)")
    })
}

/// Queries the shapes with 16-bit operands and 32-bit sums.
fn matrix_shapes(instance: &Instance, gate: &Gate, physical: vk::PhysicalDevice) -> Result<Vec<MatrixShape>> {
    // A host's replacement of the loader need not know every extension.
    let Some(api) = instance.cooperative_matrices() else { return Ok(Vec::new()) };
    // SAFETY: the physical device comes from this instance and has the extension.
    let all = gate.call("vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR", "device", || unsafe {
        api.get_physical_device_cooperative_matrix_properties(physical)
    })?;
    Ok(supported_shapes(&all))
}

/// Filters shapes with 16-bit operands and 32-bit sums; drops duplicates.
fn supported_shapes(all: &[vk::CooperativeMatrixPropertiesKHR<'_>]) -> Vec<MatrixShape> {
    let (half, single) = (vk::ComponentTypeKHR::FLOAT16, vk::ComponentTypeKHR::FLOAT32);
    let mut shapes = Vec::new();
    for p in all {
        let shape = MatrixShape { rows: p.m_size, columns: p.n_size, depth: p.k_size };
        let types = [p.a_type, p.b_type, p.c_type, p.result_type] == [half, half, single, single];
        if types && p.scope == vk::ScopeKHR::SUBGROUP && !shapes.contains(&shape) {
            shapes.push(shape);
        }
    }
    shapes
}

/// Returns the formats that the device supports as storage images.
fn storage_formats(instance: &Instance, physical: vk::PhysicalDevice) -> Vec<ImageFormat> {
    let has = |format: &ImageFormat| {
        // SAFETY: the physical device comes from this instance.
        let properties =
            unsafe { instance.raw.get_physical_device_format_properties(physical, crate::format::raw(*format)) };
        properties.optimal_tiling_features.contains(vk::FormatFeatureFlags::STORAGE_IMAGE)
    };
    ImageFormat::ALL.into_iter().filter(has).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn compute_units_are_those_of_the_vendor() {
        let amd = vk::PhysicalDeviceShaderCorePropertiesAMD::default();
        assert_eq!(compute_units(&amd, &Default::default()), None);
        let navi21 = vk::PhysicalDeviceShaderCorePropertiesAMD {
            shader_engine_count: 4,
            shader_arrays_per_engine_count: 2,
            compute_units_per_shader_array: 10,
            ..amd
        };
        assert_eq!(compute_units(&navi21, &Default::default()), Some(80));
        let h200 = vk::PhysicalDeviceShaderSMBuiltinsPropertiesNV { shader_sm_count: 132, ..Default::default() };
        assert_eq!(compute_units(&amd, &h200), Some(132));
    }

    #[test]
    fn matrix_shapes_have_fp16_operands_and_fp32_sums() {
        let (half, single) = (vk::ComponentTypeKHR::FLOAT16, vk::ComponentTypeKHR::FLOAT32);
        let shape = |m, n, k| {
            vk::CooperativeMatrixPropertiesKHR::default()
                .m_size(m)
                .n_size(n)
                .k_size(k)
                .a_type(half)
                .b_type(half)
                .c_type(single)
                .result_type(single)
                .scope(vk::ScopeKHR::SUBGROUP)
        };
        let integers = shape(16, 16, 32).a_type(vk::ComponentTypeKHR::SINT8).b_type(vk::ComponentTypeKHR::SINT8);
        let halves = shape(16, 8, 16).c_type(half).result_type(half);
        let wide = shape(64, 64, 16).scope(vk::ScopeKHR::WORKGROUP);
        let all = [integers, shape(16, 16, 16), halves, shape(16, 8, 16), wide, shape(16, 16, 16)];
        let found: Vec<_> = supported_shapes(&all).iter().map(|s| [s.rows, s.columns, s.depth]).collect();
        assert_eq!(found, [[16, 16, 16], [16, 8, 16]]);
    }
}

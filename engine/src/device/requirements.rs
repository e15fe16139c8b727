//! Device requirements of the engine, as data: required and optional features and extensions.
//!
//! Known before a device exists, so that a host can create a suitable one. Promises: the names are Vulkan's own, and
//! [`Device::open`](super::Device::open) and [`Device::adopt`](super::Device::adopt) check against the same list. The
//! caller creates the device.

use super::info::{DeviceInfo, OptionalFeatures};
use ash::{ext, khr, vk};
use std::ffi::CStr;

/// Lowest API version of instance and device.
pub const API_VERSION: u32 = vk::API_VERSION_1_3;

/// Feature used by the engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Feature {
    /// `timelineSemaphore` of Vulkan 1.2.
    TimelineSemaphore,
    /// `scalarBlockLayout` of Vulkan 1.2.
    ScalarBlockLayout,
    /// `hostQueryReset` of Vulkan 1.2.
    HostQueryReset,
    /// `synchronization2` of Vulkan 1.3.
    Synchronization2,
    /// `maintenance4` of Vulkan 1.3.
    Maintenance4,
    /// `subgroupSizeControl` of Vulkan 1.3; optional on devices of one subgroup size.
    SubgroupSizeControl,
    /// `computeFullSubgroups` of Vulkan 1.3; optional.
    ComputeFullSubgroups,
    /// `shaderBufferFloat32AtomicAdd` of `VK_EXT_shader_atomic_float`; optional.
    ShaderBufferFloat32AtomicAdd,
    /// `shaderFloat16` of Vulkan 1.2; optional, for cooperative matrices.
    ShaderFloat16,
    /// `vulkanMemoryModel` of Vulkan 1.2; optional, for cooperative matrices, whose modules require it.
    VulkanMemoryModel,
    /// `vulkanMemoryModelDeviceScope` of Vulkan 1.2; optional, enabled together with `vulkanMemoryModel`. Without it,
    /// the memory model forbids the device-scope atomics of all other kernels.
    VulkanMemoryModelDeviceScope,
    /// `cooperativeMatrix` of `VK_KHR_cooperative_matrix`; optional.
    CooperativeMatrix,
}

impl Feature {
    /// All features.
    pub const ALL: [Feature; 12] = [
        Feature::TimelineSemaphore,
        Feature::ScalarBlockLayout,
        Feature::HostQueryReset,
        Feature::Synchronization2,
        Feature::Maintenance4,
        Feature::SubgroupSizeControl,
        Feature::ComputeFullSubgroups,
        Feature::ShaderBufferFloat32AtomicAdd,
        Feature::ShaderFloat16,
        Feature::VulkanMemoryModel,
        Feature::VulkanMemoryModelDeviceScope,
        Feature::CooperativeMatrix,
    ];

    /// Returns the name in Vulkan's feature structs.
    pub fn name(self) -> &'static str {
        self.c_name().to_str().unwrap_or_default()
    }

    /// Returns the name as a C string.
    pub fn c_name(self) -> &'static CStr {
        match self {
            Feature::TimelineSemaphore => c"timelineSemaphore",
            Feature::ScalarBlockLayout => c"scalarBlockLayout",
            Feature::HostQueryReset => c"hostQueryReset",
            Feature::Synchronization2 => c"synchronization2",
            Feature::Maintenance4 => c"maintenance4",
            Feature::SubgroupSizeControl => c"subgroupSizeControl",
            Feature::ComputeFullSubgroups => c"computeFullSubgroups",
            Feature::ShaderBufferFloat32AtomicAdd => c"shaderBufferFloat32AtomicAdd",
            Feature::ShaderFloat16 => c"shaderFloat16",
            Feature::VulkanMemoryModel => c"vulkanMemoryModel",
            Feature::VulkanMemoryModelDeviceScope => c"vulkanMemoryModelDeviceScope",
            Feature::CooperativeMatrix => c"cooperativeMatrix",
        }
    }

    /// Returns the feature of a name.
    pub fn from_name(name: &str) -> Option<Feature> {
        Feature::ALL.into_iter().find(|f| f.name() == name)
    }

    /// Returns whether every device needs it. Devices with several subgroup sizes also need
    /// [`Feature::SubgroupSizeControl`].
    pub fn required(self) -> bool {
        !matches!(
            self,
            Feature::SubgroupSizeControl
                | Feature::ComputeFullSubgroups
                | Feature::ShaderBufferFloat32AtomicAdd
                | Feature::ShaderFloat16
                | Feature::VulkanMemoryModel
                | Feature::VulkanMemoryModelDeviceScope
                | Feature::CooperativeMatrix
        )
    }
}

/// Device extensions that are used if enabled. None is required.
pub const OPTIONAL_EXTENSIONS: [&CStr; 5] = [
    ext::shader_atomic_float::NAME,
    ext::memory_budget::NAME,
    khr::external_memory_fd::NAME,
    khr::external_semaphore_fd::NAME,
    khr::cooperative_matrix::NAME,
];

/// Requirements of one physical device.
#[derive(Clone, Debug)]
pub struct Requirements {
    /// Device properties; [`DeviceInfo::missing`] lists missing features.
    pub info: DeviceInfo,
    /// Lowest `apiVersion` of the instance.
    pub api_version: u32,
    /// Queue family with compute support.
    pub queue_family: Option<u32>,
    /// Required features.
    pub required: Vec<Feature>,
    /// Optional features that the device has.
    pub optional: Vec<Feature>,
    /// Required extensions; currently none.
    pub required_extensions: Vec<&'static CStr>,
    /// Optional extensions that the device has.
    pub optional_extensions: Vec<&'static CStr>,
}

impl Requirements {
    pub(crate) fn new(info: DeviceInfo, queue_family: Option<u32>) -> Requirements {
        let o = &info.optional;
        let present = |f: &Feature| match f {
            Feature::SubgroupSizeControl => o.subgroup_size_control,
            Feature::ComputeFullSubgroups => o.full_subgroups,
            Feature::ShaderBufferFloat32AtomicAdd => o.float_atomics,
            Feature::ShaderFloat16
            | Feature::VulkanMemoryModel
            | Feature::VulkanMemoryModelDeviceScope
            | Feature::CooperativeMatrix => o.cooperative_matrix,
            _ => false,
        };
        let has = |name: &&CStr| {
            let known = [
                (ext::shader_atomic_float::NAME, o.float_atomics),
                (ext::memory_budget::NAME, o.memory_budget),
                (khr::external_memory_fd::NAME, o.external_memory_fd),
                (khr::external_semaphore_fd::NAME, o.external_semaphore_fd),
                (khr::cooperative_matrix::NAME, o.cooperative_matrix),
            ];
            known.iter().any(|(known, has)| known == name && *has)
        };
        let (low, high) = info.subgroup_sizes;
        let required = |f: &Feature| f.required() || (*f == Feature::SubgroupSizeControl && low != high);
        Requirements {
            api_version: API_VERSION,
            queue_family,
            required: Feature::ALL.into_iter().filter(required).collect(),
            optional: Feature::ALL.into_iter().filter(|f| present(f) && !required(f)).collect(),
            required_extensions: Vec::new(),
            optional_extensions: OPTIONAL_EXTENSIONS.into_iter().filter(has).collect(),
            info,
        }
    }

    /// Returns every feature to enable, required ones first.
    pub fn features(&self) -> Vec<Feature> {
        self.required.iter().chain(&self.optional).copied().collect()
    }

    /// Returns every extension to enable.
    pub fn extensions(&self) -> Vec<&'static CStr> {
        self.required_extensions.iter().chain(&self.optional_extensions).copied().collect()
    }

    /// Returns the feature structs that enable all of [`Requirements::features`].
    pub fn feature_structs(&self) -> FeatureStructs {
        FeatureStructs::enabling(&self.features())
    }
}

/// Vulkan feature structs with selected features enabled. A host may merge the fields into its own structs, or chain
/// these as they are.
#[derive(Clone, Copy, Debug, Default)]
pub struct FeatureStructs {
    /// Vulkan 1.2.
    pub v12: vk::PhysicalDeviceVulkan12Features<'static>,
    /// Vulkan 1.3.
    pub v13: vk::PhysicalDeviceVulkan13Features<'static>,
    /// `VK_EXT_shader_atomic_float`; chained only if it enables something.
    pub atomics: vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT<'static>,
    /// `VK_KHR_cooperative_matrix`; chained only if it enables something.
    pub matrices: vk::PhysicalDeviceCooperativeMatrixFeaturesKHR<'static>,
}

impl FeatureStructs {
    /// Returns structs that enable exactly these features.
    pub fn enabling(features: &[Feature]) -> FeatureStructs {
        let on = |f: Feature| features.contains(&f);
        FeatureStructs {
            v12: vk::PhysicalDeviceVulkan12Features::default()
                .timeline_semaphore(on(Feature::TimelineSemaphore))
                .scalar_block_layout(on(Feature::ScalarBlockLayout))
                .host_query_reset(on(Feature::HostQueryReset))
                .shader_float16(on(Feature::ShaderFloat16))
                .vulkan_memory_model(on(Feature::VulkanMemoryModel))
                .vulkan_memory_model_device_scope(on(Feature::VulkanMemoryModelDeviceScope)),
            v13: vk::PhysicalDeviceVulkan13Features::default()
                .synchronization2(on(Feature::Synchronization2))
                .maintenance4(on(Feature::Maintenance4))
                .subgroup_size_control(on(Feature::SubgroupSizeControl))
                .compute_full_subgroups(on(Feature::ComputeFullSubgroups)),
            atomics: vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default()
                .shader_buffer_float32_atomic_add(on(Feature::ShaderBufferFloat32AtomicAdd)),
            matrices: vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default()
                .cooperative_matrix(on(Feature::CooperativeMatrix)),
        }
    }

    /// Chains the structs to a device create info.
    pub fn chain<'a>(&'a mut self, mut create: vk::DeviceCreateInfo<'a>) -> vk::DeviceCreateInfo<'a> {
        create = create.push_next(&mut self.v12).push_next(&mut self.v13);
        if self.atomics.shader_buffer_float32_atomic_add != 0 {
            create = create.push_next(&mut self.atomics);
        }
        if self.matrices.cooperative_matrix != 0 {
            create = create.push_next(&mut self.matrices);
        }
        create
    }
}

impl OptionalFeatures {
    /// Returns the subset that the given features and extensions enable.
    pub(crate) fn restricted_to(self, features: &[Feature], extensions: &[&CStr]) -> OptionalFeatures {
        let on = |f: Feature| features.contains(&f);
        let has = |name: &CStr| extensions.contains(&name);
        OptionalFeatures {
            float_atomics: self.float_atomics
                && on(Feature::ShaderBufferFloat32AtomicAdd)
                && has(ext::shader_atomic_float::NAME),
            subgroup_size_control: self.subgroup_size_control && on(Feature::SubgroupSizeControl),
            full_subgroups: self.full_subgroups && on(Feature::ComputeFullSubgroups),
            memory_budget: self.memory_budget && has(ext::memory_budget::NAME),
            external_memory_fd: self.external_memory_fd && has(khr::external_memory_fd::NAME),
            external_semaphore_fd: self.external_semaphore_fd && has(khr::external_semaphore_fd::NAME),
            cooperative_matrix: self.cooperative_matrix
                && on(Feature::CooperativeMatrix)
                && on(Feature::ShaderFloat16)
                && on(Feature::VulkanMemoryModel)
                && on(Feature::VulkanMemoryModelDeviceScope)
                && has(khr::cooperative_matrix::NAME),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_are_found_by_name_and_enabled_alone() {
        for feature in Feature::ALL {
            assert_eq!(Feature::from_name(feature.name()), Some(feature));
            let s = FeatureStructs::enabling(&[feature]);
            let bits = [
                s.v12.timeline_semaphore,
                s.v12.scalar_block_layout,
                s.v12.host_query_reset,
                s.v13.synchronization2,
                s.v13.maintenance4,
                s.v13.subgroup_size_control,
                s.v13.compute_full_subgroups,
                s.atomics.shader_buffer_float32_atomic_add,
                s.v12.shader_float16,
                s.v12.vulkan_memory_model,
                s.v12.vulkan_memory_model_device_scope,
                s.matrices.cooperative_matrix,
            ];
            let expected: Vec<u32> = Feature::ALL.iter().map(|f| u32::from(*f == feature)).collect();
            assert_eq!(bits.to_vec(), expected, "{}", feature.name());
        }
        assert_eq!(Feature::from_name("robustBufferAccess"), None);
    }

    #[test]
    fn features_not_enabled_are_not_used() {
        let all = OptionalFeatures {
            float_atomics: true,
            subgroup_size_control: true,
            full_subgroups: true,
            memory_budget: true,
            external_memory_fd: true,
            external_semaphore_fd: true,
            cooperative_matrix: true,
        };
        assert_eq!(all.restricted_to(&Feature::ALL, &OPTIONAL_EXTENSIONS), all);
        assert_eq!(all.restricted_to(&[], &[]), OptionalFeatures::default());
        // A feature without its extension counts as absent.
        assert!(!all.restricted_to(&Feature::ALL, &[]).float_atomics);
        for needed in [
            Feature::ShaderFloat16,
            Feature::VulkanMemoryModel,
            Feature::VulkanMemoryModelDeviceScope,
            Feature::CooperativeMatrix,
        ] {
            let rest: Vec<Feature> = Feature::ALL.into_iter().filter(|f| *f != needed).collect();
            assert!(!all.restricted_to(&rest, &OPTIONAL_EXTENSIONS).cooperative_matrix, "{}", needed.name());
        }
        assert_eq!(
            OptionalFeatures::default().restricted_to(&Feature::ALL, &OPTIONAL_EXTENSIONS),
            OptionalFeatures::default()
        );
    }
}

//! Cooperative matrices on a host's device: requirements and reported features.
//!
//! The device is the tests' own, behind an entry point that reports `VK_KHR_cooperative_matrix`. The extension is never
//! enabled, so the tests cover only the queries before a device is created.

use ash::{khr, vk};
use sgs_embedding::Host;
use sgs_engine::MatrixShape;
use sgs_engine::device::{Device, Feature, HostInstance, requirements};
use std::ffi::{CStr, c_char};
use std::mem::transmute;
use std::sync::OnceLock;

/// Real entry point, and the functions that this file wraps.
static REAL: OnceLock<vk::PFN_vkGetInstanceProcAddr> = OnceLock::new();
static ENUMERATE: OnceLock<vk::PFN_vkEnumerateDeviceExtensionProperties> = OnceLock::new();
static FEATURES: OnceLock<vk::PFN_vkGetPhysicalDeviceFeatures2> = OnceLock::new();
static PROPERTIES: OnceLock<vk::PFN_vkGetPhysicalDeviceProperties2> = OnceLock::new();

unsafe extern "system" fn enumerate(
    device: vk::PhysicalDevice,
    layer: *const c_char,
    count: *mut u32,
    into: *mut vk::ExtensionProperties,
) -> vk::Result {
    let real = ENUMERATE.get().expect("it was looked up");
    let name = khr::cooperative_matrix::NAME;
    // SAFETY: the pointers come from Vulkan's callers; the list holds the first call's count, one more than the
    // driver's.
    unsafe {
        let room = *count;
        let result = real(device, layer, count, into);
        let known = if into.is_null() { 0 } else { *count as usize };
        let there = (0..known).any(|i| (*into.add(i)).extension_name_as_c_str() == Ok(name));
        if !there && (into.is_null() || *count < room) {
            if !into.is_null() {
                let mut mine = vk::ExtensionProperties::default();
                for (to, from) in mine.extension_name.iter_mut().zip(name.to_bytes()) {
                    *to = *from as c_char;
                }
                *into.add(known) = mine;
            }
            *count += 1;
        }
        result
    }
}

/// Calls `real` without a struct of that type in the chain and returns it.
///
/// Older layers do not know the struct.
unsafe fn without<T>(
    head: *mut vk::BaseOutStructure<'_>,
    kind: vk::StructureType,
    real: impl FnOnce(),
) -> Option<*mut T> {
    // SAFETY: this is a chain of Vulkan's structs, and it is restored afterwards.
    unsafe {
        let mut before = head;
        while !(*before).p_next.is_null() && (*(*before).p_next).s_type != kind {
            before = (*before).p_next.cast();
        }
        let found = (*before).p_next;
        if found.is_null() {
            real();
            return None;
        }
        (*before).p_next = (*found).p_next;
        real();
        (*before).p_next = found;
        Some(found.cast())
    }
}

unsafe extern "system" fn features(device: vk::PhysicalDevice, into: *mut vk::PhysicalDeviceFeatures2<'_>) {
    type Matrices = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR<'static>;
    let real = FEATURES.get().expect("it was looked up");
    let kind = vk::StructureType::PHYSICAL_DEVICE_COOPERATIVE_MATRIX_FEATURES_KHR;
    // SAFETY: as above.
    unsafe {
        if let Some(f) = without::<Matrices>(into.cast(), kind, || real(device, into)) {
            (*f).cooperative_matrix = vk::TRUE;
        }
        let mut next: *mut vk::BaseOutStructure<'_> = (*into).p_next.cast();
        while !next.is_null() {
            if (*next).s_type == vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES {
                let f: *mut vk::PhysicalDeviceVulkan12Features<'_> = next.cast();
                ((*f).shader_float16, (*f).vulkan_memory_model) = (vk::TRUE, vk::TRUE);
                (*f).vulkan_memory_model_device_scope = vk::TRUE;
            }
            next = (*next).p_next.cast();
        }
    }
}

unsafe extern "system" fn properties(device: vk::PhysicalDevice, into: *mut vk::PhysicalDeviceProperties2<'_>) {
    type Matrices = vk::PhysicalDeviceCooperativeMatrixPropertiesKHR<'static>;
    let real = PROPERTIES.get().expect("it was looked up");
    let kind = vk::StructureType::PHYSICAL_DEVICE_COOPERATIVE_MATRIX_PROPERTIES_KHR;
    // SAFETY: as above.
    unsafe {
        if let Some(p) = without::<Matrices>(into.cast(), kind, || real(device, into)) {
            (*p).cooperative_matrix_supported_stages = vk::ShaderStageFlags::COMPUTE;
        }
    }
}

unsafe extern "system" fn shapes(
    _: vk::PhysicalDevice,
    count: *mut u32,
    into: *mut vk::CooperativeMatrixPropertiesKHR<'_>,
) -> vk::Result {
    let (half, single) = (vk::ComponentTypeKHR::FLOAT16, vk::ComponentTypeKHR::FLOAT32);
    let mine = vk::CooperativeMatrixPropertiesKHR::default()
        .m_size(16)
        .n_size(8)
        .k_size(16)
        .a_type(half)
        .b_type(half)
        .c_type(single)
        .result_type(single)
        .scope(vk::ScopeKHR::SUBGROUP);
    // SAFETY: as above; the first call has returned two.
    unsafe {
        if !into.is_null() {
            *into = mine;
            *into.add(1) = mine.result_type(half).c_type(half);
        }
        *count = 2;
    }
    vk::Result::SUCCESS
}

type Function = unsafe extern "system" fn();

unsafe extern "system" fn entry(instance: vk::Instance, name: *const c_char) -> vk::PFN_vkVoidFunction {
    type Enumerate = vk::PFN_vkEnumerateDeviceExtensionProperties;
    type Features = vk::PFN_vkGetPhysicalDeviceFeatures2;
    type Properties = vk::PFN_vkGetPhysicalDeviceProperties2;
    type Shapes = vk::PFN_vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR;
    // SAFETY: the name ends in a zero; functions are found under their own names, and the wrappers have their types.
    unsafe {
        let real = REAL.get().expect("it is set")(instance, name);
        let there = || real.expect("every driver has it");
        Some(match CStr::from_ptr(name).to_str() {
            Ok("vkEnumerateDeviceExtensionProperties") => {
                ENUMERATE.get_or_init(|| transmute::<Function, Enumerate>(there()));
                transmute::<Enumerate, Function>(enumerate)
            }
            Ok("vkGetPhysicalDeviceFeatures2") => {
                FEATURES.get_or_init(|| transmute::<Function, Features>(there()));
                transmute::<Features, Function>(features)
            }
            Ok("vkGetPhysicalDeviceProperties2") => {
                PROPERTIES.get_or_init(|| transmute::<Function, Properties>(there()));
                transmute::<Properties, Function>(properties)
            }
            Ok("vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR") => transmute::<Shapes, Function>(shapes),
            _ => return real,
        })
    }
}

#[test]
fn matrices_are_used_only_if_the_host_enables_every_feature() {
    let host = Host::new();
    let plain = host.at();
    REAL.get_or_init(|| plain.get_instance_proc_addr);
    let at = HostInstance { get_instance_proc_addr: entry, ..plain };
    // SAFETY: entry point and instance are real except for the added answers.
    let needs = unsafe { requirements(&at) }.unwrap();
    let shape = MatrixShape { rows: 16, columns: 8, depth: 16 };
    assert_eq!(needs.info.matrices, [shape]);
    assert!(!needs.info.fallbacks.iter().any(|f| f.contains("cooperative")));
    let mine = [
        Feature::ShaderFloat16,
        Feature::VulkanMemoryModel,
        Feature::VulkanMemoryModelDeviceScope,
        Feature::CooperativeMatrix,
    ];
    assert!(mine.iter().all(|f| needs.optional.contains(f) && !needs.required.contains(f)));
    assert!(needs.extensions().contains(&khr::cooperative_matrix::NAME));
    let structs = needs.feature_structs();
    let v12 = structs.v12;
    let model = [v12.vulkan_memory_model, v12.vulkan_memory_model_device_scope];
    assert_eq!([[structs.matrices.cooperative_matrix, v12.shader_float16], model], [[vk::TRUE; 2]; 2]);

    let adopt = |left_out: Option<Feature>| {
        let mut features: Vec<Feature> = host.features.iter().chain(&mine).copied().collect();
        features.retain(|f| Some(*f) != left_out);
        let extensions: Vec<_> = host.extensions.iter().copied().chain([khr::cooperative_matrix::NAME]).collect();
        let mut offer = host.offer(true);
        offer.instance = at;
        (offer.features, offer.extensions) = (&features, &extensions);
        // SAFETY: no kernel is created, so nothing needs the features that are not enabled.
        let device = unsafe { Device::adopt(offer) }.unwrap();
        let info = device.info();
        assert_eq!(info.optional.cooperative_matrix, !info.matrices.is_empty());
        info.matrices.clone()
    };
    assert_eq!(adopt(None), [shape]);
    for feature in mine {
        assert_eq!(adopt(Some(feature)), [], "{}", feature.name());
    }
}

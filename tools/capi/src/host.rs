//! Device of a host: its requirements, and its adoption.

use crate::border::{Outcome, fail, optional_string, read, strings, write};
use crate::context::{SgsContext, make, timeout};
use crate::types::*;
use sgs_engine::device::{Feature, FeatureStructs, HostDevice, HostInstance, HostQueue, QueueLock, Requirements};
use sgs_engine::vk::{self, Handle};
use std::ffi::{CString, c_char, c_void};
use std::time::Duration;

/// Requirements of one device.
pub struct SgsRequirements {
    needs: Requirements,
    name: CString,
    _texts: Vec<CString>,
    missing: Vec<*const c_char>,
    features: Vec<*const c_char>,
    extensions: Vec<*const c_char>,
    chain: Box<Chain>,
}

/// Feature structs that point at each other.
struct Chain {
    head: vk::PhysicalDeviceFeatures2<'static>,
    structs: FeatureStructs,
}

fn instance(info: &SgsInstance) -> Outcome<HostInstance> {
    let Some(get_instance_proc_addr) = info.get_instance_proc_addr else {
        return fail(SgsResult::SGS_ERROR_NULL, "SgsInstance.get_instance_proc_addr is null.");
    };
    Ok(HostInstance {
        get_instance_proc_addr,
        instance: vk::Instance::from_raw(info.instance as u64),
        physical_device: vk::PhysicalDevice::from_raw(info.physical_device as u64),
        api_version: info.api_version,
        debug_utils: info.debug_utils != 0,
    })
}

/// Queries the requirements of a physical device. A device that lacks a requirement is no error: see
/// SgsRequirementsInfo.missing. On failure `error`, if not null, holds the reason.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_requirements_create(
    info: *const SgsInstance,
    requirements: *mut *mut SgsRequirements,
    error: *mut c_char,
    error_size: usize,
) -> SgsResult {
    let run = || {
        // SAFETY: a struct by the caller's contract, with a real entry point and instance.
        let needs = unsafe { sgs_engine::device::requirements(&instance(&read(info)?)?) }?;
        let text = |s: &str| CString::new(s.replace('\0', " ")).unwrap_or_default();
        let texts: Vec<CString> = needs.info.missing.iter().map(|m| text(m)).collect();
        let missing = texts.iter().map(|t| t.as_ptr()).collect();
        let features = needs.features().iter().map(|f| f.c_name().as_ptr()).collect();
        let extensions = needs.extensions().iter().map(|e| e.as_ptr()).collect();
        let name = text(&needs.info.name);
        let structs = needs.feature_structs();
        let mut chain = Box::new(Chain { head: vk::PhysicalDeviceFeatures2::default(), structs });
        let s = &mut chain.structs;
        if s.matrices.cooperative_matrix != 0 {
            s.v13.p_next = (&raw mut s.matrices).cast();
        }
        if s.atomics.shader_buffer_float32_atomic_add != 0 {
            s.atomics.p_next = s.v13.p_next;
            s.v13.p_next = (&raw mut s.atomics).cast();
        }
        s.v12.p_next = (&raw mut s.v13).cast();
        chain.head.p_next = (&raw mut chain.structs.v12).cast();
        Ok(SgsRequirements { needs, name, _texts: texts, missing, features, extensions, chain })
    };
    // SAFETY: by the caller's contract.
    unsafe { make(requirements, error, error_size, run) }
}

/// Returns the requirements. Its pointers live as long as the requirements.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_requirements_get(
    requirements: *mut SgsRequirements,
    info: *mut SgsRequirementsInfo,
) -> SgsResult {
    // SAFETY: null or alive by the caller's contract.
    let Some(r) = (unsafe { requirements.as_mut() }) else { return SgsResult::SGS_ERROR_NULL };
    let value = SgsRequirementsInfo {
        struct_size: 0,
        api_version: r.needs.api_version,
        device_name: r.name.as_ptr(),
        missing: r.missing.as_ptr(),
        missing_count: r.missing.len() as u32,
        queue_family: r.needs.queue_family.unwrap_or(u32::MAX),
        features: r.features.as_ptr(),
        feature_count: r.features.len() as u32,
        required_feature_count: r.needs.required.len() as u32,
        extensions: r.extensions.as_ptr(),
        extension_count: r.extensions.len() as u32,
        required_extension_count: r.needs.required_extensions.len() as u32,
        device_create_next: (&raw mut r.chain.head).cast::<c_void>(),
    };
    // SAFETY: null or a struct by the caller's contract.
    unsafe { write(info, &value) }.map_or_else(|failure| failure.code, |()| SgsResult::SGS_OK)
}

/// Destroys the requirements and sets the pointer to null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_requirements_destroy(requirements: *mut *mut SgsRequirements) -> SgsResult {
    // SAFETY: null or a place for a pointer by the caller's contract.
    let Some(place) = (unsafe { requirements.as_mut() }) else { return SgsResult::SGS_ERROR_NULL };
    let raw = std::mem::replace(place, std::ptr::null_mut());
    if raw.is_null() {
        return SgsResult::SGS_ERROR_NULL;
    }
    // SAFETY: made by `make`, and not destroyed before, since destroying makes the pointer null.
    drop(unsafe { Box::from_raw(raw) });
    SgsResult::SGS_OK
}

/// Queue lock of the host, as its two functions.
struct Callbacks {
    lock: Option<unsafe extern "C" fn(*mut c_void)>,
    unlock: Option<unsafe extern "C" fn(*mut c_void)>,
    user: *mut c_void,
}

// SAFETY: the host promises that its functions may be called from whichever thread calls the library.
unsafe impl Send for Callbacks {}
// SAFETY: as above.
unsafe impl Sync for Callbacks {}

impl QueueLock for Callbacks {
    fn lock(&self) {
        if let Some(lock) = self.lock {
            // SAFETY: the host's function with the host's argument.
            unsafe { lock(self.user) };
        }
    }

    fn unlock(&self) {
        if let Some(unlock) = self.unlock {
            // SAFETY: as above.
            unsafe { unlock(self.user) };
        }
    }
}

/// Adopts a device of the host. Instance, device and queue stay alive until the context is destroyed. The named
/// features and extensions are enabled. The host uses the queue only under the lock that it passes. On failure `error`,
/// if not null, holds the reason.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_context_adopt(
    info: *const SgsHostDevice,
    context: *mut *mut SgsContext,
    error: *mut c_char,
    error_size: usize,
) -> SgsResult {
    let run = || {
        // SAFETY: structs by the caller's contract.
        let (info, at) = unsafe {
            let info = read(info)?;
            (info, read(info.instance)?)
        };
        if info.lock_queue.is_some() != info.unlock_queue.is_some() {
            let text = "SgsHostDevice.lock_queue and unlock_queue must both be given, or neither.";
            return fail(SgsResult::SGS_ERROR_NULL, text);
        }
        // SAFETY: strings by the caller's contract.
        let (names, extensions, cache) = unsafe {
            (
                strings(info.features, info.feature_count, "SgsHostDevice.features")?,
                strings(info.extensions, info.extension_count, "SgsHostDevice.extensions")?,
                optional_string(info.pipeline_cache, "SgsHostDevice.pipeline_cache")?,
            )
        };
        // Features that the library does not know are the host's own.
        let features: Vec<Feature> =
            names.iter().filter_map(|n| n.to_str().ok()).filter_map(Feature::from_name).collect();
        let queue = vk::Queue::from_raw(info.queue as u64);
        let lock = Callbacks { lock: info.lock_queue, unlock: info.unlock_queue, user: info.user };
        let host = HostDevice {
            instance: instance(&at)?,
            device: vk::Device::from_raw(info.device as u64),
            extensions: &extensions,
            features: &features,
            queue_family: info.queue_family,
            queue: (queue != vk::Queue::null()).then(|| HostQueue { queue, lock: Box::new(lock) }),
            pipeline_cache: cache.map(Into::into),
            timeout: timeout(info.timeout_seconds, Duration::from_secs(300))?,
            close_timeout: Duration::from_secs(30),
            memory_budget: None,
            faults: Default::default(),
            objects: Default::default(),
        };
        // SAFETY: the host's promises are those of this function.
        Ok(SgsContext::new(unsafe { sgs_engine::Device::adopt(host) }?))
    };
    // SAFETY: by the caller's contract.
    unsafe { make(context, error, error_size, run) }
}

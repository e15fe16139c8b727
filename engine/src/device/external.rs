//! Adoption of a host's Vulkan device. The host is an application that already runs Vulkan.
//!
//! Promises: destroys only objects created here; never waits for the whole device or a queue; orders its own work by
//! its own timeline semaphore. Touches the host's queue only between `lock` and `unlock`, for one submission at a
//! time. Checks every claim of the host that can be checked; [`Device::adopt`] lists the rest as safety requirements.

use super::fault::{Faults, Gate};
use super::instance::Instance;
use super::objects::Objects;
use super::requirements::{API_VERSION, Feature, Requirements};
use super::{Device, DeviceOptions, RawDevice, describe};
use crate::error::{Error, Result};
use ash::vk;
use std::ffi::CStr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Host's instance and its chosen physical device.
#[derive(Clone, Copy)]
pub struct HostInstance {
    /// Entry point of the loader, or the host's replacement for it. All other functions are loaded through it.
    pub get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
    /// Vulkan instance.
    pub instance: vk::Instance,
    /// Physical device of the instance.
    pub physical_device: vk::PhysicalDevice,
    /// `VkApplicationInfo::apiVersion` of the instance.
    pub api_version: u32,
    /// Whether `VK_EXT_debug_utils` is enabled on the instance; enables object names and pass labels.
    pub debug_utils: bool,
}

/// Host's device, with its enabled extensions and features.
pub struct HostDevice<'a> {
    /// Instance and physical device of the device.
    pub instance: HostInstance,
    /// Vulkan device.
    pub device: vk::Device,
    /// Enabled device extensions. Optional extensions missing from this list are not used.
    pub extensions: &'a [&'a CStr],
    /// Enabled features, of those in [`Feature`].
    pub features: &'a [Feature],
    /// Queue family of the recorded command buffers; must support compute.
    pub queue_family: u32,
    /// Queue of that family for submissions. Without one, the engine only records into the host's command buffers.
    pub queue: Option<HostQueue>,
    /// Folder of the pipeline cache; no cache if absent.
    pub pipeline_cache: Option<PathBuf>,
    /// Time limit of a wait for the engine's own work.
    pub timeout: Duration,
    /// Same as [`DeviceOptions::close_timeout`](super::DeviceOptions::close_timeout).
    pub close_timeout: Duration,
    /// Memory budget of buffers and images in bytes; the device's own budget if absent.
    pub memory_budget: Option<u64>,
    /// Injected faults, for tests of the host.
    pub faults: Faults,
    /// Counters of live Vulkan objects.
    pub objects: Objects,
}

/// Queue shared by the host.
pub struct HostQueue {
    /// Vulkan queue.
    pub queue: vk::Queue,
    /// Lock that the host holds whenever it uses the queue.
    pub lock: Box<dyn QueueLock>,
}

/// Host's lock of a queue.
///
/// Held for one `vkQueueSubmit2`, never across any other call to the host. Use `()` for a queue that the host never
/// touches.
pub trait QueueLock: Send + Sync {
    /// Blocks until the caller has exclusive use of the queue.
    fn lock(&self);
    /// Releases the queue.
    fn unlock(&self);
}

impl QueueLock for () {
    fn lock(&self) {}
    fn unlock(&self) {}
}

/// Guard that holds a host's lock and releases it on drop.
pub(super) struct Locked<'a>(&'a dyn QueueLock);

impl<'a> Locked<'a> {
    pub fn new(lock: &'a dyn QueueLock) -> Locked<'a> {
        lock.lock();
        Locked(lock)
    }
}

impl Drop for Locked<'_> {
    fn drop(&mut self) {
        self.0.unlock();
    }
}

/// Returns the requirements of a host's physical device before device creation.
///
/// # Errors
/// If the entry point does not know the instance, or the physical device does not belong to it. Missing features are
/// not an error: see [`DeviceInfo::missing`](super::DeviceInfo::missing).
///
/// # Safety
/// The entry point behaves as `vkGetInstanceProcAddr`. The instance was created through it and stays alive during the
/// call.
pub unsafe fn requirements(host: &HostInstance) -> Result<Requirements> {
    // SAFETY: as the caller promises.
    let (_, candidate) = unsafe { find_candidate(host, &Gate::default()) }?;
    Ok(Requirements::new(candidate.info, candidate.queue_family))
}

/// Finds the host's physical device among the instance's candidates.
///
/// # Safety
/// As for [`requirements`].
unsafe fn find_candidate(host: &HostInstance, gate: &Gate) -> Result<(Arc<Instance>, describe::Candidate)> {
    let refuse = |reason: &str| Err(Error::Host(reason.to_owned()));
    if host.instance == vk::Instance::null() {
        return refuse("the instance is null");
    }
    if host.api_version < API_VERSION {
        return refuse("the instance was made for a version below Vulkan 1.3 (VkApplicationInfo::apiVersion)");
    }
    for name in [c"vkEnumeratePhysicalDevices", c"vkGetDeviceProcAddr", c"vkGetPhysicalDeviceFeatures2"] {
        // SAFETY: the caller promises that the entry point and the instance are what they are called.
        if unsafe { (host.get_instance_proc_addr)(host.instance, name.as_ptr()) }.is_none() {
            return refuse(&format!("the entry point does not know {}", name.to_string_lossy()));
        }
    }
    // SAFETY: as the caller promises; the functions that matter were found above.
    let instance = unsafe { Instance::borrow(host.get_instance_proc_addr, host.instance, host.debug_utils) };
    let candidate = describe::candidates(&instance, gate)?.into_iter().find(|c| c.physical == host.physical_device);
    match candidate {
        Some(candidate) => Ok((instance, candidate)),
        None => refuse("the physical device does not belong to the instance"),
    }
}

impl Device {
    /// Adopts a host's device.
    ///
    /// # Errors
    /// [`Error::MissingFeatures`] if the device lacks a required feature or the host did not enable it;
    /// [`Error::Host`] if the host's description contradicts itself or the device.
    ///
    /// # Safety
    /// The host promises, until the last clone of the returned device and everything created from it is dropped:
    /// * The entry point behaves as `vkGetInstanceProcAddr`. Instance, device and queue come from it, belong
    ///   together, and stay alive.
    /// * The listed extensions and features are enabled on the device.
    /// * The queue belongs to the named family (created without flags). The host uses it only while it holds the
    ///   provided lock.
    /// * The host submits commands recorded here to that queue, or orders them against the engine's submissions
    ///   itself.
    pub unsafe fn adopt(host: HostDevice<'_>) -> Result<Device> {
        let refuse = |reason: String| Err(Error::Host(reason));
        let gate = Gate::new(host.faults, host.objects);
        // SAFETY: as the caller promises.
        let (instance, candidate) = unsafe { find_candidate(&host.instance, &gate) }?;
        let mut info = candidate.info;
        let not_enabled = Feature::ALL.into_iter().filter(|f| f.required() && !host.features.contains(f));
        info.missing.extend(not_enabled.map(|f| format!("{} (not enabled by the host)", f.name())));
        let control = host.features.contains(&Feature::SubgroupSizeControl);
        if info.optional.subgroup_size_control {
            info.missing.extend(describe::missing_size_control(control, info.subgroup_sizes));
        }
        if !info.missing.is_empty() {
            return Err(Error::MissingFeatures { device: info.name, missing: info.missing });
        }
        if host.device == vk::Device::null() {
            return refuse("the device is null".into());
        }
        if host.queue.as_ref().is_some_and(|q| q.queue == vk::Queue::null()) {
            return refuse("the queue is null".into());
        }
        // SAFETY: the physical device was found on the instance.
        let families =
            unsafe { instance.raw.get_physical_device_queue_family_properties(host.instance.physical_device) };
        let Some(family) = families.get(host.queue_family as usize) else {
            return refuse(format!("queue family {} does not exist, there are {}", host.queue_family, families.len()));
        };
        if !family.queue_flags.contains(vk::QueueFlags::COMPUTE) {
            return refuse(format!("queue family {} cannot compute", host.queue_family));
        }
        // SAFETY: as above.
        let known = gate.call("vkEnumerateDeviceExtensionProperties", &info.name, || unsafe {
            instance.raw.enumerate_device_extension_properties(host.instance.physical_device)
        })?;
        for name in host.extensions {
            if !known.iter().any(|k| k.extension_name_as_c_str() == Ok(*name)) {
                return refuse(format!("{} is listed as enabled, but the device has no such extension", text(name)));
            }
        }
        let functions = [c"vkQueueSubmit2", c"vkCmdPipelineBarrier2", c"vkWaitSemaphores", c"vkCmdWriteTimestamp2"];
        for name in functions {
            // SAFETY: the device belongs to the instance, as the caller promises.
            if unsafe { instance.raw.get_device_proc_addr(host.device, name.as_ptr()) }.is_none() {
                return refuse(format!("the device does not know {}", text(name)));
            }
        }
        info.optional = info.optional.restricted_to(host.features, host.extensions);
        if !info.optional.cooperative_matrix {
            info.matrices.clear();
        }
        // SAFETY: as above.
        let limits = unsafe { instance.raw.get_physical_device_properties(host.instance.physical_device) }.limits;
        info.timestamp_period = if family.timestamp_valid_bits > 0 { limits.timestamp_period } else { 0.0 };
        // SAFETY: the device is alive and belongs to the instance, as the caller promises.
        let raw = unsafe { ash::Device::load(instance.raw.fp_v1_0(), host.device) };
        let (queue, lock) = host.queue.map_or((vk::Queue::null(), None), |q| (q.queue, Some(q.lock)));
        let (physical, queue_family) = (candidate.physical, host.queue_family);
        let (owned, statistics, transfer_family) = (false, false, None);
        let raw_device = RawDevice {
            instance,
            physical,
            raw,
            owned,
            info,
            queue_family,
            queue,
            lock,
            transfer_family,
            gate,
            statistics,
        };
        let options = DeviceOptions {
            pipeline_cache: host.pipeline_cache,
            timeout: host.timeout,
            close_timeout: host.close_timeout,
            memory_budget: host.memory_budget,
            ..Default::default()
        };
        Device::assemble(raw_device, &options)
    }

    /// Returns whether the device belongs to a host.
    pub fn adopted(&self) -> bool {
        !self.0.owned
    }

    /// Returns an identifier that is unique among open devices and equal for clones.
    pub fn address(&self) -> usize {
        Arc::as_ptr(&self.0).addr()
    }

    /// Returns the raw device, for hosts that create their own objects from it.
    pub fn raw(&self) -> vk::Device {
        self.0.raw.handle()
    }
}

fn text(name: &CStr) -> String {
    name.to_string_lossy().into_owned()
}

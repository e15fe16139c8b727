//! A host's device: the engine at home in an application that has Vulkan already.
//!
//! Promises: nothing is destroyed that was not made here; nothing waits for the whole device or for a queue; the order of
//! our own work is kept by a timeline semaphore of our own; the host's queue is touched only between its `lock` and
//! `unlock`, and then only for one submission. What can be checked of a host's claims is checked; the rest is the host's
//! promise, written down at [`Device::adopt`].

use super::fault::{Faults, Gate};
use super::instance::Instance;
use super::objects::Objects;
use super::requirements::{API_VERSION, Feature, Requirements};
use super::{Bare, Device, DeviceOptions, select};
use crate::error::{Error, Result};
use ash::vk;
use std::ffi::CStr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// A host's instance and the physical device it has chosen.
#[derive(Clone, Copy)]
pub struct HostInstance {
    /// The loader's entry point, or whatever the host puts in its place. Every other function is found through it.
    pub get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
    /// The instance.
    pub instance: vk::Instance,
    /// One of its physical devices.
    pub physical_device: vk::PhysicalDevice,
    /// `VkApplicationInfo::apiVersion` of the instance.
    pub api_version: u32,
    /// Whether `VK_EXT_debug_utils` is enabled on the instance; objects then get names, passes labels.
    pub debug_utils: bool,
}

/// A host's device, and what was enabled on it.
pub struct HostDevice<'a> {
    /// Where the device comes from.
    pub instance: HostInstance,
    /// The device.
    pub device: vk::Device,
    /// Device extensions that are enabled. Optional ones that are not named here are not used.
    pub extensions: &'a [&'a CStr],
    /// Features that are enabled, of those in [`Feature`].
    pub features: &'a [Feature],
    /// The queue family whose command buffers we record; it can compute.
    pub queue_family: u32,
    /// A queue of that family, if we are to submit. Without one we only record into the host's command buffers.
    pub queue: Option<HostQueue>,
    /// Where compiled pipelines are kept between runs; nowhere if absent.
    pub pipeline_cache: Option<PathBuf>,
    /// After how long a wait for our own work gives up.
    pub timeout: Duration,
    /// As [`DeviceOptions::closing`](super::DeviceOptions::closing).
    pub closing: Duration,
    /// Bytes that our buffers and images may take; what the device tells if absent.
    pub memory_budget: Option<u64>,
    /// Failures on purpose, for tests of the host.
    pub faults: Faults,
    /// Where what we make is counted.
    pub objects: Objects,
}

/// A queue that the host shares with us.
pub struct HostQueue {
    /// The queue.
    pub queue: vk::Queue,
    /// What the host itself holds whenever it uses the queue.
    pub lock: Box<dyn QueueLock>,
}

/// The host's lock of a queue. It is held for the length of one `vkQueueSubmit2` and never while we call anything else
/// of the host's. `()` is the lock of a queue that the host itself never touches.
pub trait QueueLock: Send + Sync {
    /// Returns when nobody else uses the queue.
    fn lock(&self);
    /// Lets others use it.
    fn unlock(&self);
}

impl QueueLock for () {
    fn lock(&self) {}
    fn unlock(&self) {}
}

/// Holds a host's lock, and lets go of it on every way out.
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

/// What a physical device of the host needs to have enabled, before a device exists.
///
/// # Errors
/// If the entry point does not know the instance, or the physical device is none of its own. A device that lacks
/// something is no error: see [`DeviceInfo::missing`](super::DeviceInfo::missing).
///
/// # Safety
/// The entry point behaves as `vkGetInstanceProcAddr`, and the instance is alive, was made through it, and stays alive
/// during the call.
pub unsafe fn requirements(host: &HostInstance) -> Result<Requirements> {
    // SAFETY: as the caller promises.
    let (_, candidate) = unsafe { look(host, &Gate::default()) }?;
    Ok(Requirements::new(candidate.info, candidate.queue_family))
}

/// # Safety
/// As for [`requirements`].
unsafe fn look(host: &HostInstance, gate: &Gate) -> Result<(Arc<Instance>, select::Candidate)> {
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
    let candidate = select::candidates(&instance, gate)?.into_iter().find(|c| c.physical == host.physical_device);
    match candidate {
        Some(candidate) => Ok((instance, candidate)),
        None => refuse("the physical device does not belong to the instance"),
    }
}

impl Device {
    /// Moves into a host's device.
    ///
    /// # Errors
    /// [`Error::MissingFeatures`] if the device lacks something or the host did not enable it; [`Error::Host`] if what
    /// the host says contradicts itself or the device.
    ///
    /// # Safety
    /// The host promises, until the last clone of the returned device and everything made from it is gone:
    /// * the entry point behaves as `vkGetInstanceProcAddr`; instance, device and queue come from it, belong together,
    ///   and stay alive;
    /// * the extensions and features it names are enabled on the device;
    /// * the queue is of the named family (created without flags), and the host uses it only while it holds the lock
    ///   that it passes;
    /// * commands recorded by us are submitted to that queue, or the host orders them against our submissions itself.
    pub unsafe fn adopt(host: HostDevice<'_>) -> Result<Device> {
        let refuse = |reason: String| Err(Error::Host(reason));
        let gate = Gate::new(host.faults, host.objects);
        // SAFETY: as the caller promises.
        let (instance, candidate) = unsafe { look(&host.instance, &gate) }?;
        let mut info = candidate.info;
        let unstated = Feature::ALL.into_iter().filter(|f| f.required() && !host.features.contains(f));
        info.missing.extend(unstated.map(|f| format!("{} (not enabled by the host)", f.name())));
        let control = host.features.contains(&Feature::SubgroupSizeControl);
        if info.optional.subgroup_size_control {
            info.missing.extend(select::missing_size_control(control, info.subgroup_sizes));
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
                return refuse(format!("{} is said to be enabled, but the device has no such extension", text(name)));
            }
        }
        let functions = [c"vkQueueSubmit2", c"vkCmdPipelineBarrier2", c"vkWaitSemaphores", c"vkCmdWriteTimestamp2"];
        for name in functions {
            // SAFETY: the device belongs to the instance, as the caller promises.
            if unsafe { instance.raw.get_device_proc_addr(host.device, name.as_ptr()) }.is_none() {
                return refuse(format!("the device does not know {}", text(name)));
            }
        }
        info.optional = info.optional.only(host.features, host.extensions);
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
        // A host lends one queue: both lanes share it.
        let second = None;
        let bare = Bare { instance, physical, raw, owned: false, info, queue_family, queue, lock, second, gate };
        let options = DeviceOptions {
            pipeline_cache: host.pipeline_cache,
            timeout: host.timeout,
            closing: host.closing,
            memory_budget: host.memory_budget,
            ..Default::default()
        };
        Device::assemble(bare, &options)
    }

    /// Whether the device belongs to a host.
    pub fn adopted(&self) -> bool {
        !self.0.owned
    }

    /// Something that differs between devices that are open at the same time, and is the same for clones.
    pub fn address(&self) -> usize {
        Arc::as_ptr(&self.0).addr()
    }

    /// The raw device, for hosts that make their own objects from it.
    pub fn raw(&self) -> vk::Device {
        self.0.raw.handle()
    }
}

fn text(name: &CStr) -> String {
    name.to_string_lossy().into_owned()
}

//! A Vulkan device with a compute queue, and perhaps a second one, its memory, its pipelines and its clock.
//!
//! Promises: everything made from it keeps it alive; work is ordered by one timeline semaphore; nothing waits for the
//! whole device. Leaves the order of passes to the graph.

mod cache;
pub mod external;
pub mod fault;
mod instance;
mod limits;
mod local_size;
mod objects;
mod parking;
mod pipeline;
mod requirements;
mod second;
mod select;
mod surface;
mod swapchain;

pub use external::{HostDevice, HostInstance, HostQueue, QueueLock, requirements};
pub use fault::{Fault, FaultKind, Faults};
pub(crate) use instance::Instance;
pub use instance::Messages;
pub use limits::Limits;
pub(crate) use local_size::instructions;
pub use objects::{ObjectKind, Objects};
pub(crate) use parking::{Busy, Parked};
pub use pipeline::PipelineInfo;
pub(crate) use pipeline::{Pipeline, descriptor_type};
pub use requirements::{API_VERSION, Feature, FeatureStructs, OPTIONAL_EXTENSIONS, Requirements};
pub(crate) use second::semaphore;
pub use select::{DeviceInfo, MatrixShape, Optional};
pub use surface::{Surface, Window};
pub use swapchain::{Shown, Swapchain};

use crate::error::{Error, Result};
use crate::memory::{Activity, Memory};
use ash::{ext, vk};
use fault::Gate;
use parking::Parking;
use std::ffi::CStr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// How a device is opened.
#[derive(Clone, Debug)]
pub struct DeviceOptions {
    /// Index or part of a name; the best device if absent.
    pub select: Option<String>,
    /// Validation and synchronization validation; messages are collected in [`Device::messages`].
    pub validation: bool,
    /// Where compiled pipelines are kept between runs; nowhere if absent.
    pub pipeline_cache: Option<PathBuf>,
    /// After how long a wait gives up, unless it says so itself.
    pub timeout: Duration,
    /// How long closing the device waits for work that an earlier wait gave up on. Work that outlasts this too never
    /// ends as far as we can know; what it uses is then left to the system.
    pub closing: Duration,
    /// Bytes that buffers and images may take, all in; as many as the device or its driver has if absent.
    pub memory_budget: Option<u64>,
    /// Limits below the device's own, to test or to plan for a smaller device.
    pub limits: Limits,
    /// Failures on purpose, from the first call of opening on; nothing is planned by default.
    pub faults: Faults,
    /// Where live objects are counted.
    pub objects: Objects,
}

impl Default for DeviceOptions {
    fn default() -> Self {
        DeviceOptions {
            select: None,
            validation: false,
            pipeline_cache: None,
            timeout: Duration::from_secs(300),
            closing: Duration::from_secs(30),
            memory_budget: None,
            limits: Limits::default(),
            faults: Faults::default(),
            objects: Objects::default(),
        }
    }
}

/// A point on the device's timeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ticket(pub(crate) u64);

/// An open device; clones share it.
#[derive(Clone)]
pub struct Device(pub(crate) Arc<Shared>);

pub(crate) struct Shared {
    pub raw: ash::Device,
    /// Whether the device was made here, and not adopted.
    pub owned: bool,
    pub physical: vk::PhysicalDevice,
    pub info: DeviceInfo,
    pub queue_family: u32,
    queue: Mutex<Queue>,
    pub second: Option<second::Second>,
    second_timeline: second::SecondTimeline,
    timeline: vk::Semaphore,
    pub memory: Memory,
    pub pipelines: pipeline::Pipelines,
    pub labels: Option<ext::debug_utils::Device>,
    pub parking: Parking,
    timeout: Duration,
    closing: Duration,
    pub gate: Gate,
    // Last, so that it is dropped after everything made from it.
    pub instance: Arc<Instance>,
}

struct Queue {
    /// Null where a host does all the submitting.
    raw: vk::Queue,
    /// The host's lock around its queue.
    lock: Option<Box<dyn QueueLock>>,
    submitted: u64,
}

/// A device before it has memory and pipelines.
struct Bare {
    instance: Arc<Instance>,
    physical: vk::PhysicalDevice,
    raw: ash::Device,
    owned: bool,
    info: DeviceInfo,
    queue_family: u32,
    queue: vk::Queue,
    lock: Option<Box<dyn QueueLock>>,
    /// Family and index of a second queue that the device was made with.
    second: Option<(u32, u32)>,
    gate: Gate,
}

/// Every device that the loader knows, with what each lacks.
///
/// # Errors
/// If the loader is missing or the instance cannot be made.
pub fn devices() -> Result<Vec<DeviceInfo>> {
    let gate = Gate::default();
    let instance = Instance::new(false, &[], &gate)?;
    Ok(select::candidates(&instance, &gate)?.into_iter().map(|c| c.info).collect())
}

impl Device {
    /// Opens a device.
    ///
    /// # Errors
    /// If there is no loader, no matching device, or the device lacks a required feature (named).
    pub fn open(options: &DeviceOptions) -> Result<Device> {
        let gate = Gate::new(options.faults.clone(), options.objects.clone());
        let instance = Instance::new(options.validation, &[], &gate)?;
        let chosen = select::choose(select::candidates(&instance, &gate)?, options.select.as_deref())?;
        Device::make(instance, chosen, &[], gate, options)
    }

    /// Opens a chosen device, with more extensions than every device has.
    fn make(
        instance: Arc<Instance>,
        chosen: select::Candidate,
        more: &[&'static CStr],
        gate: Gate,
        options: &DeviceOptions,
    ) -> Result<Device> {
        let info = chosen.info;
        let queue_family = chosen.queue_family.ok_or_else(|| Error::MissingFeatures {
            device: info.name.clone(),
            missing: vec!["a compute queue".into()],
        })?;
        // SAFETY: the physical device comes from this instance.
        let families = unsafe { instance.raw.get_physical_device_queue_family_properties(chosen.physical) };
        let second = second::place(&families, queue_family);
        let queues = second::queues(queue_family, second);
        let needs = Requirements::new(info.clone(), Some(queue_family));
        let extensions: Vec<_> = needs.extensions().iter().chain(more).map(|name| name.as_ptr()).collect();
        let mut features = needs.feature_structs();
        let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&extensions);
        let create = features.chain(create);
        // SAFETY: the physical device belongs to the instance; every feature and extension asked for was reported by it.
        let raw = gate.make(ObjectKind::Device, "vkCreateDevice", &info.name, || unsafe {
            instance.raw.create_device(chosen.physical, &create, None)
        })?;
        // SAFETY: the queue was created with the device.
        let queue = unsafe { raw.get_device_queue(queue_family, 0) };
        let physical = chosen.physical;
        let bare = Bare { instance, physical, raw, owned: true, info, queue_family, queue, lock: None, second, gate };
        Device::assemble(bare, options)
    }

    /// Gives a device its timeline, memory and pipelines; a device of our own is destroyed if that fails.
    fn assemble(bare: Bare, options: &DeviceOptions) -> Result<Device> {
        let Bare { instance, physical, raw, owned, mut info, queue_family, queue, lock, second, gate } = bare;
        options.limits.lower(&mut info);
        let parts = parts(&instance, &raw, &gate, physical, &info, options.pipeline_cache.clone());
        let (timeline, memory, pipelines) = match parts {
            Ok(parts) => parts,
            Err(error) => {
                if owned {
                    // SAFETY: nothing made from the device is left.
                    unsafe { raw.destroy_device(None) };
                    gate.gone(ObjectKind::Device);
                }
                return Err(error);
            }
        };
        memory.set_budget(options.memory_budget);
        let second = second.map(|second| second::Second::new(&raw, second));
        let labels = instance.debug_utils.then(|| ext::debug_utils::Device::new(&instance.raw, &raw));
        tracing::debug!(device = info.name, driver = info.driver, owned, "device opened");
        let device = Device(Arc::new(Shared {
            raw,
            owned,
            physical,
            info,
            queue_family,
            queue: Mutex::new(Queue { raw: queue, lock, submitted: 0 }),
            second,
            second_timeline: second::SecondTimeline::default(),
            timeline,
            memory,
            pipelines,
            labels,
            parking: Parking::default(),
            timeout: options.timeout,
            closing: options.closing,
            gate,
            instance,
        }));
        if owned {
            // A host has names of its own.
            device.0.name(queue, "queue");
        }
        device.0.name(timeline, "timeline");
        Ok(device)
    }

    /// Whether plans for two queues have two here.
    pub fn has_second_queue(&self) -> bool {
        self.0.second.is_some()
    }

    /// What is known of the device.
    pub fn info(&self) -> &DeviceInfo {
        &self.0.info
    }

    /// Validation messages so far (empty without validation).
    pub fn messages(&self) -> &Arc<Messages> {
        &self.0.instance.messages
    }

    /// Version of the validation layer, where it runs: what it can see differs.
    pub fn validation_version(&self) -> Option<(u32, u32, u32)> {
        self.0.instance.layer_version
    }

    /// Whether validation runs.
    pub fn validating(&self) -> bool {
        self.0.instance.validation
    }

    /// Bytes of device memory in use by this device's buffers, now and at most.
    pub fn memory_use(&self) -> (u64, u64) {
        self.0.memory.usage()
    }

    /// Does something, and says how many bytes of device memory were in use at most meanwhile, beyond those that were before. Calls
    /// must neither nest nor overlap, or figures are wrong.
    pub fn memory_during<T>(&self, work: impl FnOnce() -> T) -> (T, u64) {
        self.0.memory.during(work)
    }

    /// What has been done with this device's memory so far.
    pub fn activity(&self) -> Activity {
        self.0.memory.activity()
    }

    /// The plan of failures that the device was opened with.
    pub fn faults(&self) -> &Faults {
        &self.0.gate.faults
    }

    /// Counts of live Vulkan objects by kind.
    pub fn objects(&self) -> &Objects {
        &self.0.gate.objects
    }

    /// Waits until everything up to `ticket` is done.
    ///
    /// # Errors
    /// [`Error::Timeout`] after the time set at opening; [`Error::DeviceLost`].
    pub fn wait(&self, ticket: Ticket, what: &str) -> Result<()> {
        self.0.wait(ticket, what, self.0.timeout)
    }

    /// As [`Device::wait`], with a time limit of its own.
    ///
    /// # Errors
    /// [`Error::Timeout`], [`Error::DeviceLost`].
    pub fn wait_within(&self, ticket: Ticket, what: &str, limit: Duration) -> Result<()> {
        self.0.wait(ticket, what, limit)
    }

    /// After how long a wait gives up, as set at opening.
    pub fn timeout(&self) -> Duration {
        self.0.timeout
    }

    /// Whether everything up to `ticket` is done.
    ///
    /// # Errors
    /// [`Error::DeviceLost`].
    pub fn is_done(&self, ticket: Ticket) -> Result<bool> {
        // SAFETY: the semaphore belongs to this device.
        let value = self.0.gate.call("vkGetSemaphoreCounterValue", "timeline", || unsafe {
            self.0.raw.get_semaphore_counter_value(self.0.timeline)
        })?;
        Ok(value >= ticket.0)
    }

    /// The last submission so far.
    pub fn last_ticket(&self) -> Ticket {
        Ticket(self.0.queue().submitted)
    }
}

/// A wait is so many shorter ones: clocks go on while a process is stopped (Ctrl-Z), its work does not, and no more than a part of the limit
/// is used up by that.
const PARTS: u32 = 16;

impl Shared {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Waits for a ticket, no longer than `limit`.
    pub fn wait(&self, ticket: Ticket, what: &str, limit: Duration) -> Result<()> {
        match self.gate.call("vkWaitSemaphores", what, || self.wait_raw(ticket, limit)) {
            Err(Error::Vulkan { result: vk::Result::TIMEOUT, .. }) => {
                Err(Error::Timeout { what: what.to_owned(), limit, pass: None })
            }
            other => other,
        }
    }

    fn wait_raw(&self, ticket: Ticket, limit: Duration) -> std::result::Result<(), vk::Result> {
        let semaphores = [self.timeline];
        let values = [ticket.0];
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        let part = u64::try_from(limit.as_nanos().div_ceil(u128::from(PARTS))).unwrap_or(u64::MAX);
        for _ in 1..PARTS {
            // SAFETY: the semaphore belongs to this device and the arrays outlive the call.
            match unsafe { self.raw.wait_semaphores(&info, part) } {
                Err(vk::Result::TIMEOUT) => {}
                other => return other,
            }
        }
        // SAFETY: as before.
        unsafe { self.raw.wait_semaphores(&info, part) }
    }

    /// Waits for everything submitted. Goes past the gate: on a lost device, or one that was declared lost on purpose, it
    /// still has to be known that nothing runs any more. False if something does.
    fn settle(&self) -> bool {
        let last = Ticket(self.queue().submitted);
        // A device that is really lost runs nothing.
        matches!(self.wait_raw(last, self.closing), Ok(()) | Err(vk::Result::ERROR_DEVICE_LOST))
    }

    /// Submits one recorded command buffer; its end is the returned ticket.
    pub fn submit(&self, commands: vk::CommandBuffer, what: &str) -> Result<Ticket> {
        self.submit_between(commands, &[], &[], what)
    }

    /// As [`Shared::submit`], after and before semaphores of a host.
    pub fn submit_between(
        &self,
        commands: vk::CommandBuffer,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        signals: &[vk::SemaphoreSubmitInfo<'_>],
        what: &str,
    ) -> Result<Ticket> {
        let mut queue = self.queue();
        let value = queue.submitted + 1;
        let mut all = Vec::with_capacity(signals.len() + 1);
        all.push(semaphore(self.timeline, value));
        all.extend_from_slice(signals);
        self.submit_to(queue.raw, queue.lock.as_deref(), commands, waits, &all, what)?;
        queue.submitted = value;
        Ok(Ticket(value))
    }

    /// Gives an object a name that tools and messages show.
    pub fn name<T: vk::Handle>(&self, handle: T, text: &str) {
        let Some(api) = &self.labels else { return };
        let Ok(name) = std::ffi::CString::new(text) else { return };
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(handle).object_name(&name);
        // SAFETY: the handle was made from this device. A failure only loses the name.
        let _lost_name =
            self.gate.call("vkSetDebugUtilsObjectNameEXT", text, || unsafe { api.set_debug_utils_object_name(&info) });
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        if !self.settle() {
            // Freeing what the GPU may still use is worse than leaving it.
            tracing::error!("the device did not finish its work within {:?}; its objects are left", self.closing);
            self.memory.leave();
            std::mem::forget(self.instance.clone());
            return;
        }
        self.clear_parking();
        self.destroy_second_timeline();
        self.pipelines.destroy(&self.raw, &self.gate);
        self.memory.shut_down();
        // SAFETY: all work is done and everything made from the device is destroyed.
        unsafe { self.raw.destroy_semaphore(self.timeline, None) };
        self.gate.gone(ObjectKind::Semaphore);
        if self.owned {
            // SAFETY: as above; a host's device stays.
            unsafe { self.raw.destroy_device(None) };
            self.gate.gone(ObjectKind::Device);
        }
    }
}

/// What every device has: its timeline, its memory, its pipelines.
fn parts(
    instance: &Instance,
    raw: &ash::Device,
    gate: &Gate,
    physical: vk::PhysicalDevice,
    info: &DeviceInfo,
    cache: Option<PathBuf>,
) -> Result<(vk::Semaphore, Memory, pipeline::Pipelines)> {
    let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
    let semaphore = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
    // SAFETY: the device is alive and has timeline semaphores.
    let timeline = gate.make(ObjectKind::Semaphore, "vkCreateSemaphore", "timeline", || unsafe {
        raw.create_semaphore(&semaphore, None)
    })?;
    let rest = pipeline::Pipelines::new(raw, gate, info, cache).and_then(|pipelines| {
        match Memory::new(instance, raw, physical, info) {
            Ok(memory) => Ok((timeline, memory, pipelines)),
            Err(error) => {
                pipelines.destroy(raw, gate);
                Err(error)
            }
        }
    });
    rest.inspect_err(|_| {
        // SAFETY: the semaphore was made above and nothing uses it.
        unsafe { raw.destroy_semaphore(timeline, None) };
        gate.gone(ObjectKind::Semaphore);
    })
}

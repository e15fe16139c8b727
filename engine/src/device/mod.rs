//! Vulkan device: compute queue, memory, pipelines and timeline.
//!
//! Promises: objects created from a device keep it alive; one timeline semaphore orders all work; nothing waits for
//! the whole device. The graph orders passes.

mod allocation;
mod cache;
mod compile_only;
mod deferred;
mod describe;
mod driver_files;
pub mod external;
pub mod fault;
mod find;
mod identity;
mod info;
mod instance;
mod limits;
mod local_size;
mod objects;
mod pipeline;
mod planning;
mod queue;
mod requirements;
mod select;
mod statistics;
mod surface;
mod transfer_queue;

pub use compile_only::CompileOnlyDevice;
pub(crate) use deferred::{Busy, DeferredObject};
pub use driver_files::{DRIVER_VARIABLES, DriverFile, driver_files};
pub use external::{HostDevice, HostInstance, HostQueue, QueueLock, requirements};
pub use fault::{Fault, FaultKind, Faults};
pub use find::{FoundDevice, devices, find_device};
pub use identity::{Environment, Selection, select_auto};
pub use info::{DeviceInfo, MatrixShape, OptionalFeatures};
pub(crate) use instance::Instance;
pub use instance::Messages;
pub use limits::Limits;
pub use objects::{ObjectKind, Objects};
pub use pipeline::PipelineInfo;
pub(crate) use pipeline::{Pipeline, Wanted, descriptor_type};
pub use planning::PlannedGpu;
use queue::Queue;
pub(crate) use queue::semaphore;
pub use requirements::{API_VERSION, Feature, FeatureStructs, OPTIONAL_EXTENSIONS, Requirements};
pub use statistics::{KernelStatistics, Statistic};
pub use surface::{Surface, Window};
pub(crate) use transfer_queue::{TransferQueue, TransferTicket};

use crate::allocator::{Activity, Memory};
use crate::error::{Error, Result};
use ash::{ext, vk};
use deferred::DeferredDestruction;
use fault::Gate;
use std::ffi::CStr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Options for opening a device.
#[derive(Clone, Debug)]
pub struct DeviceOptions {
    /// Index, part of a name, `uuid:…`, `pci:…` or `auto`; `auto` if absent. See [`select_auto`].
    pub select: Option<String>,
    /// Enables validation and synchronization validation; [`Device::messages`] collects the messages.
    pub validation: bool,
    /// Folder of the pipeline cache; no cache if absent.
    pub pipeline_cache: Option<PathBuf>,
    /// Default time limit of a wait.
    pub timeout: Duration,
    /// Time limit for unfinished work when the device closes. Objects that are still in use after it are leaked.
    pub close_timeout: Duration,
    /// Memory budget of buffers and images in bytes; the budget of the device or driver if absent.
    pub memory_budget: Option<u64>,
    /// Limits below the device's own, to test or plan for a smaller device.
    pub limits: Limits,
    /// Makes the driver capture statistics of kernels; see [`Device::kernel_statistics`].
    pub kernel_statistics: bool,
    /// Plans for this GPU instead of running on the device; see [`Device::plans`].
    pub plan_for: Option<PlannedGpu>,
    /// Injected faults, active from the first call of opening; none by default.
    pub faults: Faults,
    /// Counters of live Vulkan objects.
    pub objects: Objects,
}

impl Default for DeviceOptions {
    fn default() -> Self {
        DeviceOptions {
            select: None,
            validation: false,
            pipeline_cache: None,
            timeout: Duration::from_secs(300),
            close_timeout: Duration::from_secs(30),
            memory_budget: None,
            limits: Limits::default(),
            kernel_statistics: false,
            plan_for: None,
            faults: Faults::default(),
            objects: Objects::default(),
        }
    }
}

/// Point on the device's timeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ticket(pub(crate) u64);

/// Open device; clones share it.
#[derive(Clone)]
pub struct Device(pub(crate) Arc<Shared>);

pub(crate) struct Shared {
    pub raw: ash::Device,
    /// Whether the device was created here rather than adopted from a host.
    pub owned: bool,
    pub physical: vk::PhysicalDevice,
    pub info: DeviceInfo,
    pub queue_family: u32,
    queue: Mutex<Queue>,
    timeline: vk::Semaphore,
    /// Queue that only transfers, for uploads; a host's device has none.
    pub transfer_queue: Option<TransferQueue>,
    pub memory: Memory,
    pub pipelines: pipeline::Pipelines,
    /// Queries of statistics; present if they were requested and the driver reports them.
    statistics: Option<ash::khr::pipeline_executable_properties::Device>,
    /// Plans of executors; present if graphs are only collected.
    plans: Option<planning::Plans>,
    pub labels: Option<ext::debug_utils::Device>,
    pub deferred: DeferredDestruction,
    timeout: Duration,
    close_timeout: Duration,
    pub gate: Gate,
    // Last field, so that it is dropped after everything created from it.
    pub instance: Arc<Instance>,
}

/// Device without memory and pipelines.
struct RawDevice {
    instance: Arc<Instance>,
    physical: vk::PhysicalDevice,
    raw: ash::Device,
    owned: bool,
    info: DeviceInfo,
    queue_family: u32,
    queue: vk::Queue,
    lock: Option<Box<dyn QueueLock>>,
    /// Family of queues that only transfer, with which the device was created.
    transfer_family: Option<u32>,
    gate: Gate,
    /// Whether the driver can report statistics of kernels.
    statistics: bool,
}

impl Device {
    /// Opens a device.
    ///
    /// # Errors
    /// If the loader is missing, no device matches, or the device lacks a required feature (named).
    pub fn open(options: &DeviceOptions) -> Result<Device> {
        let gate = Gate::new(options.faults.clone(), options.objects.clone());
        let instance = Instance::new(options.validation, &[], &gate)?;
        let candidates = describe::candidates(&instance, &gate)?;
        let selected = select::choose(candidates, options.select.as_deref(), &Environment::current())?;
        Device::make(instance, selected, &[], gate, options)
    }

    /// Opens a selected device with extra extensions.
    fn make(
        instance: Arc<Instance>,
        selected: describe::Candidate,
        extra_extensions: &[&'static CStr],
        gate: Gate,
        options: &DeviceOptions,
    ) -> Result<Device> {
        let info = selected.info;
        let queue_family = selected.queue_family.ok_or_else(|| Error::MissingFeatures {
            device: info.name.clone(),
            missing: vec!["a compute queue".into()],
        })?;
        let transfer_family = selected.transfer_family.filter(|family| *family != queue_family);
        let families = [Some(queue_family), transfer_family];
        let of = |family| vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0]);
        let queues: Vec<_> = families.into_iter().flatten().map(of).collect();
        let needs = Requirements::new(info.clone(), Some(queue_family));
        let statistics = options.kernel_statistics && statistics::supported(&instance, &gate, selected.physical)?;
        let statistics_extension = statistics.then_some(statistics::EXTENSION);
        let extensions =
            needs.extensions().into_iter().chain(extra_extensions.iter().copied()).chain(statistics_extension);
        let extensions: Vec<_> = extensions.map(CStr::as_ptr).collect();
        let mut features = needs.feature_structs();
        let mut executables =
            vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
        let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&extensions);
        let mut create = features.chain(create);
        if statistics {
            create = create.push_next(&mut executables);
        }
        // SAFETY: the physical device belongs to the instance; it reported every enabled feature and extension.
        let raw = gate.make(ObjectKind::Device, "vkCreateDevice", &info.name, || unsafe {
            instance.raw.create_device(selected.physical, &create, None)
        })?;
        // SAFETY: the queue was created with the device.
        let queue = unsafe { raw.get_device_queue(queue_family, 0) };
        let physical = selected.physical;
        let (owned, lock) = (true, None);
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
        Device::assemble(raw_device, options)
    }

    /// Adds timeline, memory and pipelines to a device. Destroys an owned device on failure.
    fn assemble(raw_device: RawDevice, options: &DeviceOptions) -> Result<Device> {
        let RawDevice {
            instance,
            physical,
            raw,
            owned,
            mut info,
            queue_family,
            queue,
            lock,
            transfer_family,
            gate,
            statistics,
        } = raw_device;
        options.limits.lower(&mut info);
        if let Some(gpu) = &options.plan_for {
            gpu.replace(&mut info);
        }
        let resources = create_resources(&instance, &raw, &gate, physical, &info, options.pipeline_cache.clone());
        let resources = resources.and_then(|(timeline, memory, pipelines)| {
            let queue = transfer_family.map(|family| TransferQueue::new(&raw, &gate, family)).transpose();
            match queue {
                Ok(queue) => Ok((timeline, memory, pipelines, queue)),
                Err(error) => {
                    destroy_resources(&raw, &gate, timeline, &memory, &pipelines);
                    Err(error)
                }
            }
        });
        let (timeline, memory, pipelines, transfer_queue) = match resources {
            Ok(resources) => resources,
            Err(error) => {
                if owned {
                    // SAFETY: no object created from the device is left.
                    unsafe { raw.destroy_device(None) };
                    gate.count_destroyed(ObjectKind::Device);
                }
                return Err(error);
            }
        };
        memory.set_budget(options.memory_budget);
        let labels = instance.debug_utils.then(|| ext::debug_utils::Device::new(&instance.raw, &raw));
        let statistics = statistics.then(|| ash::khr::pipeline_executable_properties::Device::new(&instance.raw, &raw));
        tracing::debug!(device = info.name, driver = info.driver, owned, "device opened");
        let device = Device(Arc::new(Shared {
            raw,
            owned,
            physical,
            info,
            queue_family,
            queue: Mutex::new(Queue::new(queue, lock)),
            timeline,
            transfer_queue,
            memory,
            pipelines,
            statistics,
            plans: options.plan_for.as_ref().map(|_| planning::Plans::default()),
            labels,
            deferred: DeferredDestruction::default(),
            timeout: options.timeout,
            close_timeout: options.close_timeout,
            gate,
            instance,
        }));
        if owned {
            // A host names its own queue.
            device.0.name(queue, "queue");
        }
        device.0.name(timeline, "timeline");
        Ok(device)
    }

    /// Returns the properties of the device.
    pub fn info(&self) -> &DeviceInfo {
        &self.0.info
    }

    /// Returns the validation messages (empty without validation).
    pub fn messages(&self) -> &Arc<Messages> {
        &self.0.instance.messages
    }

    /// Returns the version of the validation layer, if enabled. Versions detect different errors.
    pub fn validation_version(&self) -> Option<(u32, u32, u32)> {
        self.0.instance.layer_version
    }

    /// Returns whether validation is enabled.
    pub fn validation_enabled(&self) -> bool {
        self.0.instance.validation
    }

    /// Returns current and peak device memory of this device's buffers, in bytes.
    pub fn memory_use(&self) -> (u64, u64) {
        self.0.memory.usage()
    }

    /// Runs `work` and returns its result and its peak device memory in bytes. The peak is relative to the usage at the
    /// start.
    ///
    /// Calls must neither nest nor overlap; otherwise the result is wrong.
    pub fn memory_during<T>(&self, work: impl FnOnce() -> T) -> (T, u64) {
        self.0.memory.during(work)
    }

    /// Returns whether large uploads use a queue that only transfers.
    pub fn has_transfer_queue(&self) -> bool {
        self.0.transfer_queue.is_some()
    }

    /// Returns counters of buffers, images and transfers.
    pub fn activity(&self) -> Activity {
        self.0.memory.activity()
    }

    /// Returns the fault plan of the device.
    pub fn faults(&self) -> &Faults {
        &self.0.gate.faults
    }

    /// Returns the counts of live Vulkan objects by kind.
    pub fn objects(&self) -> &Objects {
        &self.0.gate.objects
    }

    /// Waits until all work up to `ticket` is done.
    ///
    /// # Errors
    /// [`Error::Timeout`] after the device's time limit; [`Error::DeviceLost`].
    pub fn wait(&self, ticket: Ticket, what: &str) -> Result<()> {
        self.0.wait(ticket, what, self.0.timeout)
    }

    /// Like [`Device::wait`], with an explicit time limit.
    ///
    /// # Errors
    /// [`Error::Timeout`], [`Error::DeviceLost`].
    pub fn wait_within(&self, ticket: Ticket, what: &str, limit: Duration) -> Result<()> {
        self.0.wait(ticket, what, limit)
    }

    /// Returns the default time limit of a wait.
    pub fn timeout(&self) -> Duration {
        self.0.timeout
    }

    /// Returns whether all work up to `ticket` is done.
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

    /// Returns the ticket of the last submission.
    pub fn last_ticket(&self) -> Ticket {
        self.0.last_ticket()
    }
}

impl Shared {
    /// Names an object for capture tools and messages.
    pub fn name<T: vk::Handle>(&self, handle: T, text: &str) {
        pipeline::set_name(self.labels.as_ref(), &self.gate, handle, text);
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        if !self.wait_idle() {
            // Leaking objects is safer than freeing what the GPU may still use.
            tracing::error!(
                "the device did not finish its work within {:?}; its objects are leaked",
                self.close_timeout
            );
            self.memory.leak();
            std::mem::forget(self.instance.clone());
            return;
        }
        self.clear_deferred();
        if let Some(queue) = &self.transfer_queue {
            queue.destroy(&self.raw, &self.gate);
        }
        destroy_resources(&self.raw, &self.gate, self.timeline, &self.memory, &self.pipelines);
        if self.owned {
            // SAFETY: as above; a host's device is not destroyed.
            unsafe { self.raw.destroy_device(None) };
            self.gate.count_destroyed(ObjectKind::Device);
        }
    }
}

/// Destroys what [`create_resources`] made. All work is done.
fn destroy_resources(
    raw: &ash::Device,
    gate: &Gate,
    timeline: vk::Semaphore,
    memory: &Memory,
    pipelines: &pipeline::Pipelines,
) {
    pipelines.destroy(raw, gate);
    memory.shut_down();
    // SAFETY: all work is done and everything created from the device is destroyed.
    unsafe { raw.destroy_semaphore(timeline, None) };
    gate.count_destroyed(ObjectKind::Semaphore);
}

/// Creates timeline, memory and pipelines of a device.
fn create_resources(
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
        let driver_budget = info.optional.memory_budget;
        match Memory::new(&instance.raw, raw, physical, &info.name, info.memory_bytes, driver_budget) {
            Ok(memory) => Ok((timeline, memory, pipelines)),
            Err(error) => {
                pipelines.destroy(raw, gate);
                Err(error)
            }
        }
    });
    rest.inspect_err(|_| {
        // SAFETY: the semaphore was created above and nothing uses it.
        unsafe { raw.destroy_semaphore(timeline, None) };
        gate.count_destroyed(ObjectKind::Semaphore);
    })
}

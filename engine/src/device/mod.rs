//! Vulkan device: compute queue, memory, pipelines and timeline.
//!
//! Promises: objects created from a device keep it alive; one timeline semaphore orders all work; nothing waits for
//! the whole device. The graph orders passes.

mod allocation;
mod cache;
mod compile_only;
mod deferred;
mod driver_files;
pub mod external;
pub mod fault;
mod find;
mod identity;
mod instance;
mod limits;
mod local_size;
mod objects;
mod pipeline;
mod planning;
mod requirements;
mod select;
mod statistics;
mod surface;

pub use compile_only::CompileOnlyDevice;
pub(crate) use deferred::{Busy, DeferredObject};
pub use driver_files::{DRIVER_VARIABLES, DriverFile, driver_files};
use external::Locked;
pub use external::{HostDevice, HostInstance, HostQueue, QueueLock, requirements};
pub use fault::{Fault, FaultKind, Faults};
pub use find::{FoundDevice, devices, find_device};
pub use identity::{Environment, Selection, select_auto};
pub(crate) use instance::Instance;
pub use instance::Messages;
pub use limits::Limits;
pub use objects::{ObjectKind, Objects};
pub use pipeline::PipelineInfo;
pub(crate) use pipeline::{Pipeline, Wanted, descriptor_type};
pub use planning::PlannedGpu;
pub use requirements::{API_VERSION, Feature, FeatureStructs, OPTIONAL_EXTENSIONS, Requirements};
pub use select::{DeviceInfo, MatrixShape, OptionalFeatures};
pub use statistics::{KernelStatistics, Statistic};
pub use surface::{Surface, Window};

use crate::allocator::{Activity, Memory};
use crate::error::{Error, Result};
use ash::{ext, vk};
use deferred::DeferredDestruction;
use fault::Gate;
use std::ffi::CStr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};
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

/// Queue of a device, and the number of its submissions.
pub(crate) struct Queue {
    /// Null if the host submits all work.
    pub raw: vk::Queue,
    /// Host's lock of its queue.
    lock: Option<Box<dyn QueueLock>>,
    submitted: u64,
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
        let candidates = select::candidates(&instance, &gate)?;
        let selected = select::choose(candidates, options.select.as_deref(), &Environment::current())?;
        Device::make(instance, selected, &[], gate, options)
    }

    /// Opens a selected device with extra extensions.
    fn make(
        instance: Arc<Instance>,
        selected: select::Candidate,
        extra_extensions: &[&'static CStr],
        gate: Gate,
        options: &DeviceOptions,
    ) -> Result<Device> {
        let info = selected.info;
        let queue_family = selected.queue_family.ok_or_else(|| Error::MissingFeatures {
            device: info.name.clone(),
            missing: vec!["a compute queue".into()],
        })?;
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&[1.0])];
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
        let raw_device =
            RawDevice { instance, physical, raw, owned: true, info, queue_family, queue, lock: None, gate, statistics };
        Device::assemble(raw_device, options)
    }

    /// Adds timeline, memory and pipelines to a device. Destroys an owned device on failure.
    fn assemble(raw_device: RawDevice, options: &DeviceOptions) -> Result<Device> {
        let RawDevice { instance, physical, raw, owned, mut info, queue_family, queue, lock, gate, statistics } =
            raw_device;
        options.limits.lower(&mut info);
        if let Some(gpu) = &options.plan_for {
            gpu.replace(&mut info);
        }
        let resources = create_resources(&instance, &raw, &gate, physical, &info, options.pipeline_cache.clone());
        let (timeline, memory, pipelines) = match resources {
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
            queue: Mutex::new(Queue { raw: queue, lock, submitted: 0 }),
            timeline,
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
        Ticket(self.0.queue().submitted)
    }
}

/// Number of shorter waits that make up one wait.
///
/// The clock runs while a process is stopped (Ctrl-Z), but its GPU work does not. A stop then uses up at most one
/// part of the limit.
const WAIT_SLICES: u32 = 16;

impl Shared {
    /// Locks the queue.
    pub fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Waits for a ticket, at most for `limit`.
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
        let slice = u64::try_from(limit.as_nanos().div_ceil(u128::from(WAIT_SLICES))).unwrap_or(u64::MAX);
        for _ in 1..WAIT_SLICES {
            // SAFETY: the semaphore belongs to this device and the arrays outlive the call.
            match unsafe { self.raw.wait_semaphores(&info, slice) } {
                Err(vk::Result::TIMEOUT) => {}
                other => return other,
            }
        }
        // SAFETY: as before.
        unsafe { self.raw.wait_semaphores(&info, slice) }
    }

    /// Waits for all submitted work. Returns false if work still runs at the time limit.
    ///
    /// Bypasses the gate: after an injected or real device loss, the caller must still know that nothing runs.
    fn wait_idle(&self) -> bool {
        let last = Ticket(self.queue().submitted);
        // A lost device runs nothing.
        matches!(self.wait_raw(last, self.close_timeout), Ok(()) | Err(vk::Result::ERROR_DEVICE_LOST))
    }

    /// Submits one recorded command buffer; returns the ticket of its end.
    pub fn submit(&self, commands: vk::CommandBuffer, what: &str) -> Result<Ticket> {
        self.submit_between(commands, &[], &[], what)
    }

    /// Like [`Shared::submit`], with wait and signal semaphores of a host.
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
        if queue.raw == vk::Queue::null() {
            return Err(Error::NoQueue(what.to_owned()));
        }
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let submit = [vk::SubmitInfo2::default()
            .wait_semaphore_infos(waits)
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(&all)];
        let locked = queue.lock.as_deref().map(Locked::new);
        // SAFETY: the command buffer is recorded and not pending (its owner waits for its ticket first). The queue is
        // locked, a host's queue by the host's own lock too. The timeline only grows; the caller orders all other
        // semaphores.
        self.gate.call("vkQueueSubmit2", what, || unsafe {
            self.raw.queue_submit2(queue.raw, &submit, vk::Fence::null())
        })?;
        drop(locked);
        queue.submitted = value;
        Ok(Ticket(value))
    }

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
        self.pipelines.destroy(&self.raw, &self.gate);
        self.memory.shut_down();
        // SAFETY: all work is done and everything created from the device is destroyed.
        unsafe { self.raw.destroy_semaphore(self.timeline, None) };
        self.gate.count_destroyed(ObjectKind::Semaphore);
        if self.owned {
            // SAFETY: as above; a host's device is not destroyed.
            unsafe { self.raw.destroy_device(None) };
            self.gate.count_destroyed(ObjectKind::Device);
        }
    }
}

/// Returns a semaphore value for all stages.
pub(crate) fn semaphore(semaphore: vk::Semaphore, value: u64) -> vk::SemaphoreSubmitInfo<'static> {
    vk::SemaphoreSubmitInfo::default()
        .semaphore(semaphore)
        .value(value)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
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

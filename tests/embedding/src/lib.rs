//! Host application with its own instance, device, locked queue and commands.
//!
//! The host uses `ash`, and from the engine only the calls that a host needs. It enables validation, including
//! synchronization validation across submissions, and collects the messages itself. Dropping the host fails the test if
//! the layer has reported a message.
//!
//! A thread may have several hosts; those of other threads wait ([`turn()`](sgs_tests::turn())).

mod objects;

use ash::{ext, vk};
pub use objects::{COLOR, Owned};
use sgs_engine::device::{Feature, HostDevice, HostInstance, HostQueue, QueueLock, Requirements, requirements};
use sgs_tests::{Turn, turn};
use std::ffi::{CStr, c_void};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

/// Lock of the host around its queue. Records its state and the number of times it was taken.
#[derive(Default)]
pub struct Lock {
    held: Mutex<bool>,
    free: Condvar,
    /// Number of times the lock was taken.
    pub taken: AtomicU64,
    /// Whether the lock was ever released without being held.
    pub misused: AtomicBool,
}

impl QueueLock for Lock {
    fn lock(&self) {
        let mut held = self.held.lock().unwrap();
        while *held {
            held = self.free.wait(held).unwrap();
        }
        *held = true;
        self.taken.fetch_add(1, Ordering::SeqCst);
    }

    fn unlock(&self) {
        let mut held = self.held.lock().unwrap();
        if !*held {
            self.misused.store(true, Ordering::SeqCst);
        }
        *held = false;
        self.free.notify_one();
    }
}

/// Lends the lock to the engine, which takes ownership of its lock.
struct Lent(Arc<Lock>);

impl QueueLock for Lent {
    fn lock(&self) {
        self.0.lock();
    }

    fn unlock(&self) {
        self.0.unlock();
    }
}

/// Features that a host leaves out when it creates its device.
#[derive(Clone, Copy, Debug, Default)]
pub struct Without {
    /// Whether to leave out optional features and extensions.
    pub optional: bool,
}

/// Vulkan application that lends its device to the engine.
pub struct Host {
    _entry: ash::Entry,
    /// Vulkan instance.
    pub instance: ash::Instance,
    /// Logical device.
    pub device: ash::Device,
    /// Physical device.
    pub physical: vk::PhysicalDevice,
    /// Family of the queue.
    pub family: u32,
    /// Compute queue.
    pub queue: vk::Queue,
    /// Lock of the queue.
    pub lock: Arc<Lock>,
    /// Requirements that the engine reported.
    pub needs: Requirements,
    /// Enabled features.
    pub features: Vec<Feature>,
    /// Enabled extensions.
    pub extensions: Vec<&'static CStr>,
    get: vk::PFN_vkGetInstanceProcAddr,
    pool: vk::CommandPool,
    debug: ext::debug_utils::Instance,
    messenger: vk::DebugUtilsMessengerEXT,
    messages: Box<Mutex<Vec<String>>>,
    // Last field, so that others wait until the device is destroyed.
    _turn: Turn,
}

impl Host {
    /// Creates a host with everything that the engine can use.
    pub fn new() -> Host {
        Host::with(Without::default())
    }

    /// Creates a host that leaves features out.
    pub fn with(without: Without) -> Host {
        let turn = turn();
        // SAFETY: the system's loader is sound.
        let entry = unsafe { ash::Entry::load() }.expect("there is a Vulkan loader");
        let messages = Box::new(Mutex::new(Vec::new()));
        let application = vk::ApplicationInfo::default().application_name(c"host").api_version(vk::API_VERSION_1_3);
        let layers = [c"VK_LAYER_KHRONOS_validation".as_ptr()];
        let extensions = [ext::debug_utils::NAME.as_ptr()];
        let enables = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut validation = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enables);
        let info = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_layer_names(&layers)
            .enabled_extension_names(&extensions)
            .push_next(&mut validation);
        // SAFETY: everything in `info` outlives the call.
        let instance = unsafe { entry.create_instance(&info, None) }.expect("an instance with validation");
        let debug = ext::debug_utils::Instance::new(&entry, &instance);
        let listener = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(
                vk::DebugUtilsMessageSeverityFlagsEXT::ERROR | vk::DebugUtilsMessageSeverityFlagsEXT::WARNING,
            )
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(on_message))
            .user_data((&raw const *messages).cast_mut().cast());
        // SAFETY: the sink is boxed and outlives the messenger.
        let messenger = unsafe { debug.create_debug_utils_messenger(&listener, None) }.expect("a messenger");
        let get = entry.static_fn().get_instance_proc_addr;
        // The engine evaluates every physical device before a device exists.
        // SAFETY: the instance is alive.
        let all = unsafe { instance.enumerate_physical_devices() }.expect("physical devices");
        let wanted = std::env::var("SGS_TEST_DEVICE").unwrap_or_default().to_lowercase();
        let described = |physical: vk::PhysicalDevice| {
            let at = HostInstance {
                get_instance_proc_addr: get,
                instance: instance.handle(),
                physical_device: physical,
                api_version: vk::API_VERSION_1_3,
                debug_utils: true,
            };
            // SAFETY: entry point and instance are real and alive.
            (physical, unsafe { requirements(&at) }.expect("an answer"))
        };
        let fits = |(_, r): &(vk::PhysicalDevice, Requirements)| {
            r.info.missing.is_empty() && r.info.name.to_lowercase().contains(&wanted)
        };
        let (physical, needs) = all.into_iter().map(described).find(fits).expect("a device that fits");
        let family = needs.queue_family.expect("a compute queue");
        let features = if without.optional { needs.required.clone() } else { needs.features() };
        let names = if without.optional { needs.required_extensions.clone() } else { needs.extensions() };
        let mut structs = sgs_engine::device::FeatureStructs::enabling(&features);
        let pointers: Vec<_> = names.iter().map(|n| n.as_ptr()).collect();
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
        let info = structs
            .chain(vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&pointers));
        // SAFETY: the engine's requirements name only what the device has.
        let device = unsafe { instance.create_device(physical, &info, None) }.expect("a device");
        let pool = vk::CommandPoolCreateInfo::default()
            .queue_family_index(family)
            .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
        // SAFETY: the device is alive and has the queue.
        let (queue, pool) =
            unsafe { (device.get_device_queue(family, 0), device.create_command_pool(&pool, None).expect("a pool")) };
        Host {
            _entry: entry,
            instance,
            device,
            physical,
            family,
            queue,
            lock: Arc::default(),
            needs,
            features,
            extensions: names,
            get,
            pool,
            debug,
            messenger,
            messages,
            _turn: turn,
        }
    }

    /// Describes the instance to the engine.
    pub fn at(&self) -> HostInstance {
        HostInstance {
            get_instance_proc_addr: self.get,
            instance: self.instance.handle(),
            physical_device: self.physical,
            api_version: vk::API_VERSION_1_3,
            debug_utils: true,
        }
    }

    /// Describes the device to the engine.
    ///
    /// `with_queue`: whether the engine gets the queue, to submit by itself.
    pub fn offer(&self, with_queue: bool) -> HostDevice<'_> {
        HostDevice {
            instance: self.at(),
            device: self.device.handle(),
            extensions: &self.extensions,
            features: &self.features,
            queue_family: self.family,
            queue: with_queue.then(|| HostQueue { queue: self.queue, lock: Box::new(Lent(self.lock.clone())) }),
            pipeline_cache: None,
            timeout: Duration::from_secs(120),
            close_timeout: Duration::from_secs(30),
            memory_budget: None,
            faults: Default::default(),
            objects: Default::default(),
        }
    }

    /// Opens the engine on this host's device.
    pub fn adopt(&self) -> sgs_engine::Device {
        // SAFETY: the host's description is true, and the host outlives the objects of the tests.
        unsafe { sgs_engine::Device::adopt(self.offer(true)) }.unwrap_or_else(|e| panic!("{e}"))
    }

    /// Allocates a command buffer and begins it.
    pub fn begin(&self) -> vk::CommandBuffer {
        let info = vk::CommandBufferAllocateInfo::default()
            .command_pool(self.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        let begin = vk::CommandBufferBeginInfo::default();
        // SAFETY: the pool is alive and used by this thread alone.
        unsafe {
            let commands = self.device.allocate_command_buffers(&info).expect("commands")[0];
            self.device.begin_command_buffer(commands, &begin).expect("begun");
            commands
        }
    }

    /// Ends the commands and submits them between semaphores, with an optional fence.
    pub fn submit(
        &self,
        commands: vk::CommandBuffer,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        signals: &[vk::SemaphoreSubmitInfo<'_>],
        fence: vk::Fence,
    ) {
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let info = [vk::SubmitInfo2::default()
            .wait_semaphore_infos(waits)
            .signal_semaphore_infos(signals)
            .command_buffer_infos(&buffers)];
        // SAFETY: the commands are recorded; the queue is used under its lock.
        unsafe {
            self.device.end_command_buffer(commands).expect("ended");
            self.lock.lock();
            let submitted = self.device.queue_submit2(self.queue, &info, fence);
            self.lock.unlock();
            submitted.expect("submitted");
        }
    }

    /// Ends the commands, submits them and waits with a fence.
    pub fn run(&self, commands: vk::CommandBuffer) {
        let fence = self.fence();
        self.submit(commands, &[], &[], fence);
        self.wait(fence);
    }

    /// Creates a fence.
    pub fn fence(&self) -> vk::Fence {
        // SAFETY: the device is alive.
        unsafe { self.device.create_fence(&vk::FenceCreateInfo::default(), None) }.expect("a fence")
    }

    /// Waits for a fence and destroys it.
    pub fn wait(&self, fence: vk::Fence) {
        // SAFETY: the fence is alive, and signaled after the wait.
        unsafe {
            self.device.wait_for_fences(&[fence], true, u64::MAX).expect("done");
            self.device.destroy_fence(fence, None);
        }
    }

    /// Creates a semaphore, timeline or binary.
    pub fn semaphore(&self, timeline: bool) -> vk::Semaphore {
        let kind = if timeline { vk::SemaphoreType::TIMELINE } else { vk::SemaphoreType::BINARY };
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(kind);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device is alive.
        unsafe { self.device.create_semaphore(&info, None) }.expect("a semaphore")
    }

    /// Destroys a semaphore when the queue is idle.
    ///
    /// lavapipe 22.3 still accesses a timeline semaphore of a submission's wait shortly after that submission's fence
    /// is signaled.
    pub fn destroy_semaphore(&self, semaphore: vk::Semaphore) {
        // SAFETY: the caller no longer uses the semaphore; the queue is used under its lock.
        unsafe {
            self.lock.lock();
            let idle = self.device.queue_wait_idle(self.queue);
            self.lock.unlock();
            idle.expect("idle");
            self.device.destroy_semaphore(semaphore, None);
        }
    }

    /// Takes the collected validation messages.
    pub fn messages(&self) -> Vec<String> {
        std::mem::take(&mut *self.messages.lock().unwrap())
    }
}

impl Default for Host {
    fn default() -> Self {
        Host::new()
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        // SAFETY: the host no longer uses its objects; validation reports remaining objects of the engine.
        unsafe {
            self.device.destroy_command_pool(self.pool, None);
            self.device.destroy_device(None);
            self.debug.destroy_debug_utils_messenger(self.messenger, None);
            self.instance.destroy_instance(None);
        }
        let messages = self.messages();
        if !std::thread::panicking() {
            assert!(!self.lock.misused.load(Ordering::SeqCst), "the queue's lock was given back twice");
            assert!(messages.is_empty(), "validation reported {}:\n{}", messages.len(), messages.join("\n"));
        }
    }
}

/// Collects a message of the validation layer.
///
/// # Safety
/// The layer calls this function with the registered sink.
unsafe extern "system" fn on_message(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data, and the sink outlives the messenger.
    let (text, sink) = unsafe { ((*data).message_as_c_str(), &*user.cast::<Mutex<Vec<String>>>()) };
    let text = text.map_or_else(String::new, |t| t.to_string_lossy().into_owned());
    sink.lock().unwrap_or_else(|e| e.into_inner()).push(text);
    vk::FALSE
}

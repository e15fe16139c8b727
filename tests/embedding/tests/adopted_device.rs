//! Engine on a host's device: refusals, enabled features, unchanged state of the host.

use ash::vk;
use sgs_embedding::{Host, Without};
use sgs_engine::device::{Feature, HostDevice, requirements};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_engine::{Device, DeviceOptions, Error, Location};
use sgs_passes::kernel::{groups, stage};
use sgs_shaders::fill;
use std::ffi::{CStr, c_char};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Runs a kernel on a device and checks its output.
fn works(device: &Device) {
    let mut g = Graph::new("fill");
    let out = g.external("out", 4 * 500);
    let bindings = fill::Bindings { target: out.into() }.entries();
    let push = fill::Push { count: 500, value: 7 };
    stage(&mut g, "fill", &fill::KERNEL, bindings, fill::Specs::default().entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(device.info().subgroup_size))
        .dispatch(groups(500, 256))
        .unwrap();
    let plan = Arc::new(g.compile(&CompileOptions::default()).unwrap());
    let mut exec = Executor::new(device, plan, ExecOptions { timestamps: true, ..Default::default() }).unwrap();
    let memory = device.buffer("out", 4 * 500, Location::Device).unwrap();
    device.fill(&memory, 1).unwrap();
    exec.bind(out, &memory).unwrap();
    exec.submit(&[]).unwrap();
    exec.finish().unwrap();
    assert!(device.download_as::<u32>(&memory, 500).unwrap().iter().all(|w| *w == 7));
    assert_eq!(exec.take_times().len(), 1);
}

/// Checks that the host can still use its device.
fn host_works(host: &Host) {
    let (image, buffer) = (host.image([4, 4], vk::Format::R8G8B8A8_UNORM), host.buffer(64));
    let commands = host.begin();
    use vk::ImageLayout as L;
    host.transition(commands, image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
    host.clear(commands, image.raw, [0.0, 1.0, 0.0, 1.0]);
    host.transition(commands, image.raw, L::TRANSFER_DST_OPTIMAL, L::TRANSFER_SRC_OPTIMAL);
    host.read_image(commands, image.raw, [4, 4], buffer.raw);
    host.run(commands);
    assert!(host.read(&buffer, 64).chunks(4).all(|t| t == [0, 255, 0, 255]));
    host.destroy_image(image);
    host.destroy_buffer(buffer);
}

#[test]
fn kernels_run_on_a_hosts_device_that_the_host_keeps() {
    let host = Host::new();
    host_works(&host);
    let mut offer = host.offer(true);
    let objects = sgs_engine::device::Objects::default();
    offer.objects = objects.clone();
    // SAFETY: the host's description is true.
    let device = unsafe { Device::adopt(offer) }.unwrap();
    assert!(device.adopted());
    works(&device);
    host_works(&host);
    assert!(objects.total() > 0);
    drop(device);
    assert_eq!(objects.alive(), [], "something is left in the host's device");
    // A second engine on the device, after the first has been dropped.
    works(&host.adopt());
    host_works(&host);
}

#[test]
fn features_that_the_host_does_not_enable_are_not_used() {
    let host = Host::with(Without { optional: true });
    let device = host.adopt();
    assert_eq!(device.info().optional, Default::default());
    works(&device);
    let refused = device.shared_buffer("b", 64).unwrap_err();
    assert!(matches!(refused, Error::MissingExtension { extension: "VK_KHR_external_memory_fd", .. }), "{refused}");
}

/// Returns the message of a refusal.
fn refused(change: impl FnOnce(&mut HostDevice<'_>)) -> String {
    let host = Host::new();
    let mut offer = host.offer(true);
    change(&mut offer);
    // SAFETY: errors in the description are found before it is used.
    let error = unsafe { Device::adopt(offer) }.err().expect("it is refused");
    assert!(matches!(error, Error::Host(_) | Error::MissingFeatures { .. }), "{error}");
    error.to_string()
}

#[test]
fn false_claims_are_refused_by_name() {
    let has = |text: String, word: &str| assert!(text.contains(word), "\"{word}\" is missing: {text}");
    has(refused(|o| o.device = vk::Device::null()), "the device is null");
    has(refused(|o| o.instance.instance = vk::Instance::null()), "the instance is null");
    has(refused(|o| o.instance.api_version = vk::API_VERSION_1_2), "below Vulkan 1.3");
    has(refused(|o| o.instance.physical_device = vk::PhysicalDevice::null()), "physical device does not belong");
    has(refused(|o| o.queue_family = 1000), "queue family 1000 does not exist");
    has(refused(|o| o.queue.as_mut().unwrap().queue = vk::Queue::null()), "the queue is null");
    has(refused(|o| o.extensions = &[c"VK_SGS_imagined"]), "VK_SGS_imagined");
    has(refused(|o| o.features = &[]), "timelineSemaphore (not enabled by the host)");
    for feature in Feature::ALL.into_iter().filter(|f| f.required()) {
        let rest: Vec<Feature> = Feature::ALL.into_iter().filter(|f| *f != feature).collect();
        let text = refused(|o| o.features = Vec::leak(rest));
        has(text.clone(), feature.name());
        assert_eq!(text.matches("not enabled").count(), 1, "{text}");
    }
    unsafe extern "system" fn nothing(_: vk::Instance, _: *const c_char) -> vk::PFN_vkVoidFunction {
        None
    }
    has(refused(|o| o.instance.get_instance_proc_addr = nothing), "does not know vkEnumeratePhysicalDevices");
}

#[test]
fn requirements_suffice_to_create_a_device() {
    let host = Host::new();
    // SAFETY: entry point and instance are real.
    let needs = unsafe { requirements(&host.at()) }.unwrap();
    assert_eq!(needs.required.len(), Feature::ALL.iter().filter(|f| f.required()).count());
    assert!(needs.queue_family.is_some() && needs.info.missing.is_empty());
    assert!(needs.features().len() == needs.required.len() + needs.optional.len());
    // The host of these tests creates its device from these requirements alone, with validation on.
    works(&host.adopt());
}

#[test]
fn without_a_queue_nothing_is_submitted() {
    let host = Host::new();
    // SAFETY: the host's description is true.
    let device = unsafe { Device::adopt(host.offer(false)) }.unwrap();
    let buffer = device.buffer("b", 64, Location::Device).unwrap();
    let error = device.upload(&buffer, 0, &[0; 64]).unwrap_err();
    assert!(matches!(&error, Error::NoQueue(what) if what == "upload"), "{error}");
    assert_eq!(host.lock.taken.load(Ordering::SeqCst), 0);
}

#[test]
fn queue_is_used_only_under_its_lock() {
    let host = Host::new();
    let device = host.adopt();
    let buffer = device.buffer("b", 64, Location::Device).unwrap();
    let before = host.lock.taken.load(Ordering::SeqCst);
    device.fill(&buffer, 3).unwrap();
    assert_eq!(host.lock.taken.load(Ordering::SeqCst), before + 1, "one submission");
    // Host and engine submit at the same time; validation reports queues that are used without a lock.
    std::thread::scope(|s| {
        let other = device.clone();
        s.spawn(move || (0..30).for_each(|_| works(&other)));
        (0..30).for_each(|_| host_works(&host));
    });
}

/// Calls that the engine must not make on a host's device.
const FORBIDDEN: [&CStr; 6] = [
    c"vkDeviceWaitIdle",
    c"vkQueueWaitIdle",
    c"vkDestroyDevice",
    c"vkDestroyInstance",
    c"vkCreateDevice",
    c"vkCreateInstance",
];
static CAUGHT: AtomicU32 = AtomicU32::new(0);

unsafe extern "system" fn caught() {
    CAUGHT.fetch_add(1, Ordering::SeqCst);
}

unsafe fn forbidden(name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: names are strings.
    FORBIDDEN.contains(&unsafe { CStr::from_ptr(name) }).then_some(caught)
}

static REAL: std::sync::OnceLock<vk::PFN_vkGetInstanceProcAddr> = std::sync::OnceLock::new();
static REAL_DEVICE: std::sync::OnceLock<vk::PFN_vkGetDeviceProcAddr> = std::sync::OnceLock::new();

/// Entry point of the host that returns traps for forbidden calls.
unsafe extern "system" fn watched(instance: vk::Instance, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: names are strings; the real entry point is the loader's.
    unsafe {
        if let Some(trap) = forbidden(name) {
            return Some(trap);
        }
        let found = REAL.get().expect("set before")(instance, name);
        if CStr::from_ptr(name) == c"vkGetDeviceProcAddr" {
            let real = std::mem::transmute::<vk::PFN_vkVoidFunction, vk::PFN_vkGetDeviceProcAddr>(found);
            let _same = REAL_DEVICE.set(real);
            let own: vk::PFN_vkGetDeviceProcAddr = watched_device;
            return std::mem::transmute::<vk::PFN_vkGetDeviceProcAddr, vk::PFN_vkVoidFunction>(own);
        }
        found
    }
}

unsafe extern "system" fn watched_device(device: vk::Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: as above.
    unsafe { forbidden(name).or_else(|| REAL_DEVICE.get().expect("set before")(device, name)) }
}

#[test]
fn engine_never_waits_for_or_destroys_a_hosts_device() {
    let host = Host::new();
    let mut offer = host.offer(true);
    REAL.get_or_init(|| offer.instance.get_instance_proc_addr);
    offer.instance.get_instance_proc_addr = watched;
    // SAFETY: the entry point is the real one except for calls that the engine does not make.
    let device = unsafe { Device::adopt(offer) }.unwrap();
    works(&device);
    drop(device);
    assert_eq!(CAUGHT.load(Ordering::SeqCst), 0);
    // The trap works.
    // SAFETY: the name is a string; the returned function takes no arguments.
    unsafe { watched(vk::Instance::null(), c"vkDeviceWaitIdle".as_ptr()).expect("a trap")() };
    assert_eq!(CAUGHT.load(Ordering::SeqCst), 1);
}

#[test]
fn several_engines_run_in_one_process() {
    let (one, two) = (Host::new(), Host::new());
    let (a, b, again) = (one.adopt(), two.adopt(), one.adopt());
    let own = Device::open(&DeviceOptions {
        select: std::env::var("SGS_TEST_DEVICE").ok(),
        validation: true,
        ..Default::default()
    })
    .unwrap();
    std::thread::scope(|s| {
        for device in [&a, &b, &again, &own] {
            s.spawn(move || (0..5).for_each(|_| works(device)));
        }
    });
    drop(a);
    works(&again);
    assert_eq!(own.messages().take(), Vec::<String>::new());
}

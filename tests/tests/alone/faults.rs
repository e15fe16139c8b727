//! Fault injection into each fallible call, in each way that the call can fail.
//!
//! The typed error names the call and its purpose. Nothing leaks, and the same device works afterwards.

use sgs_engine::device::fault::Call;
use sgs_engine::device::{Fault, FaultKind, Faults, ObjectKind, Objects};

use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_engine::{Device, DeviceOptions, Error, ImageFormat, Location, Result};
use sgs_tests::{busy, turn};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

const WORDS: u64 = 256;

/// Calls whose failure is tolerated: object names and the cache on disk.
const TOLERATED: [&str; 2] = ["vkSetDebugUtilsObjectNameEXT", "vkGetPipelineCacheData"];

fn options(faults: &Faults, objects: &Objects) -> DeviceOptions {
    DeviceOptions {
        select: std::env::var("SGS_TEST_DEVICE").ok(),
        validation: true,
        faults: faults.clone(),
        objects: objects.clone(),
        ..Default::default()
    }
}

/// Runs a small workload that covers the engine.
///
/// Uses buffers, an image, transfers, timestamps, replays in flight, and growth of a buffer. The graph has a uniform,
/// fills, copies, direct and indirect dispatches, and an arena.
fn workload(device: &Device) -> Result<Vec<u32>> {
    let bytes = 4 * WORDS;
    let seeds: Vec<u32> = (1..=WORDS as u32).collect();
    let data = device.buffer("data", bytes, Location::Device)?;
    device.upload(&data, 0, bytemuck::cast_slice(&seeds))?;
    let groups = device.buffer("groups", 12, Location::Device)?;
    device.upload(&groups, 0, bytemuck::cast_slice(&[4u32, 1, 1]))?;
    let out = device.buffer("out", bytes, Location::Device)?;
    let image = device.image("image", [8, 8], ImageFormat::R32Float)?;
    device.upload_image(&image, bytemuck::cast_slice(&seeds[..64]))?;
    let texels = device.download_image(&image)?;
    assert_eq!(texels, bytemuck::cast_slice::<u32, u8>(&seeds[..64]));
    image_copies(device, &seeds[..64])?;

    let mut graph = Graph::new("work");
    let settings = graph.uniform("settings", 4);
    let (input, args) = (graph.input("data", bytes), graph.input("groups", 12));
    let (result, spare) = (graph.external("out", bytes), graph.transient("spare", bytes));
    let scratch = graph.transient("scratch", bytes);
    let kernel = busy::kernel();
    graph.fill("clear", spare, 0)?;
    graph.copy("take", input, scratch)?;
    graph.pass("mix", &kernel).bind("settings", settings).bind("data", scratch).dispatch([4, 1, 1])?;
    graph.pass("mix again", &kernel).bind("settings", settings).bind("data", scratch).dispatch_indirect(args, 0)?;
    graph.copy("give", scratch, result)?;
    graph.copy("give first", scratch.slice(0, 4), spare.slice(0, 4))?;
    let plan = Arc::new(graph.compile(&CompileOptions::default())?);
    let mut exec = Executor::new(device, plan, ExecOptions { timestamps: true, ..Default::default() })?;
    exec.bind(input, &data)?;
    exec.bind(args, &groups)?;
    exec.bind(result, &out)?;
    for rounds in [1u32, 2, 3] {
        exec.submit(&[(settings, &rounds.to_ne_bytes())])?;
    }
    exec.finish()?;
    assert!(!exec.take_times().is_empty());

    // The buffer grows to twice the capacity. The old contents come first.
    let grown = device.buffer("data, grown", 2 * bytes, Location::Device)?;
    device.copy(&data, &grown, bytes)?;
    drop(data);
    exec.bind(input, &grown)?;
    let ticket = exec.submit(&[(settings, &5u32.to_ne_bytes())])?;
    device.is_done(ticket)?;
    exec.finish()?;
    device.download_as(&out, WORDS as usize)
}

/// Replays copies through a transient image.
fn image_copies(device: &Device, texels: &[u32]) -> Result<()> {
    let bytes = 4 * texels.len() as u64;
    let mut graph = Graph::new("images");
    let (from, to) = (graph.input("texels", bytes), graph.external("texels back", bytes));
    let passing = graph.transient_image("passing", [8, 8], ImageFormat::R32Float);
    graph.copy_to_image("in", from, passing)?;
    graph.copy_from_image("out", passing, to)?;
    let plan = Arc::new(graph.compile(&CompileOptions::default())?);
    let mut exec = Executor::new(device, plan, ExecOptions::default())?;
    let mut made = Vec::new();
    for (buffer, name) in [(from, "texels"), (to, "texels back")] {
        made.push(device.buffer(name, bytes, Location::Device)?);
        exec.bind(buffer, &made[made.len() - 1])?;
    }
    device.upload(&made[0], 0, bytemuck::cast_slice(texels))?;
    for _ in 0..3 {
        exec.submit(&[])?;
        exec.finish()?;
    }
    assert_eq!(device.download_as::<u32>(&made[1], texels.len())?, texels);
    Ok(())
}

fn expected() -> Vec<u32> {
    (1..=WORDS as u32).map(|v| busy::reference(busy::reference(v, 5), 5)).collect()
}

/// Opens a device, runs the workload and closes the device.
fn everything(faults: &Faults, objects: &Objects) -> Result<Vec<u32>> {
    let device = Device::open(&options(faults, objects))?;
    workload(&device)
}

/// Returns whether an error names the failed call, its purpose and the failure.
fn names(error: &Error, call: &Call, kind: FaultKind) -> bool {
    match error {
        Error::Vulkan { call: c, what, .. } => *c == call.call && *what == call.what,
        Error::OutOfMemory { what, reason, .. } => *what == call.what && reason.starts_with(call.call),
        Error::DeviceLost(text) => {
            kind == FaultKind::DeviceLost && text.contains(call.call) && text.contains(&call.what)
        }
        Error::Timeout { what, .. } => kind == FaultKind::Timeout && *what == call.what,
        _ => false,
    }
}

/// Returns the live objects that must not outlive a workload.
fn lasting(device: &Device, objects: &Objects) -> Vec<(ObjectKind, u64)> {
    use ObjectKind::{Instance, Messenger, Pipeline, PipelineCache, PipelineLayout, Semaphore, SetLayout};
    let stays = |kind: ObjectKind| match kind {
        Instance | Messenger | ObjectKind::Device | PipelineCache | Pipeline | PipelineLayout | SetLayout => 1,
        Semaphore => 1 + u64::from(device.has_transfer_queue()),
        _ => 0,
    };
    objects.alive().into_iter().filter(|(kind, n)| stays(*kind) != *n).collect()
}

/// Fails the given call of the workload on a new device and checks all guarantees.
#[track_caller]
fn fail_once(n: u64, call: &Call, kind: FaultKind) {
    let (faults, objects) = (Faults::default(), Objects::default());
    let context = format!("call {n}, {} for \"{}\", failed with {kind:?}", call.call, call.what);
    let device = Device::open(&options(&faults, &objects)).unwrap();
    let messages = device.messages().clone();
    faults.inject(Fault { call: Fault::ANY, skip: n, result: kind });
    let outcome = workload(&device);
    let fired = faults.take_fired();
    assert_eq!(fired, [(call.clone(), kind)], "{context}");
    match outcome {
        Ok(values) => {
            assert!(TOLERATED.contains(&call.call), "{context}: nobody noticed");
            assert_eq!(values, expected(), "{context}");
        }
        Err(error) => assert!(names(&error, call, kind), "{context}: {error}"),
    }
    let begin = Instant::now();
    if kind == FaultKind::DeviceLost {
        // Every later call reports the loss immediately.
        for outcome in [workload(&device).map(drop), device.wait(device.last_ticket(), "x")] {
            let error = outcome.unwrap_err();
            assert!(matches!(error, Error::DeviceLost(_)), "{context}: {error}");
        }
    } else {
        device.wait(device.last_ticket(), "the rest").unwrap();
        assert_eq!(device.collect(), 0, "{context}");
        assert_eq!(lasting(&device, &objects), [], "{context}");
        assert_eq!(
            (device.memory_use().0, device.activity().buffers, device.activity().images),
            (0, 0, 0),
            "{context}"
        );
        assert_eq!(workload(&device).unwrap_or_else(|e| panic!("{context}, then {e}")), expected(), "{context}");
    }
    drop(device);
    assert!(begin.elapsed() < Duration::from_secs(20), "{context}: closing took {:?}", begin.elapsed());
    assert_eq!(objects.alive(), [], "{context}");
    let log = messages.take();
    assert!(log.is_empty(), "{context}: {}", log.join("\n"));
}

/// Returns the calls that a workload makes.
fn record(work: impl FnOnce(&Faults)) -> Vec<Call> {
    let faults = Faults::default();
    faults.record();
    work(&faults);
    faults.take_record()
}

#[test]
fn opening_fails_cleanly_at_every_call() {
    let _turn = turn();
    let calls = record(|faults| drop(Device::open(&options(faults, &Objects::default())).unwrap()));
    assert!(calls.len() > 6 && calls.iter().any(|c| c.call == "vkCreateInstance"), "{calls:?}");
    for (n, call) in calls.iter().enumerate() {
        for &kind in FaultKind::of(call.call) {
            let (faults, objects) = (Faults::default(), Objects::default());
            faults.inject(Fault { call: Fault::ANY, skip: n as u64, result: kind });
            match Device::open(&options(&faults, &objects)) {
                Err(error) => assert!(names(&error, call, kind), "{call:?} {kind:?}: {error}"),
                Ok(device) => {
                    drop(device);
                    assert!(TOLERATED.contains(&call.call), "{call:?} {kind:?}: nobody noticed");
                }
            }
            assert_eq!(objects.alive(), [], "{call:?} {kind:?}");
            assert_eq!(everything(&faults, &objects).unwrap(), expected());
        }
    }
}

#[test]
fn workload_fails_cleanly_at_every_call() {
    let _turn = turn();
    let (faults, objects) = (Faults::default(), Objects::default());
    let device = Device::open(&options(&faults, &objects)).unwrap();
    faults.record();
    assert_eq!(workload(&device).unwrap(), expected());
    let calls = faults.take_record();
    drop(device);
    let mut kinds: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (n, call) in calls.iter().enumerate() {
        kinds.entry(call.call).or_default().push(n);
    }
    println!(
        "{} calls of {} kinds: {:?}",
        calls.len(),
        kinds.len(),
        kinds.iter().map(|(k, v)| (k, v.len())).collect::<Vec<_>>()
    );
    assert!(calls.len() > 100 && kinds.len() > 20, "the workload shrank: {} calls", calls.len());
    let mut runs = 0;
    for (n, call) in calls.iter().enumerate() {
        let ways = FaultKind::of(call.call);
        // Every call fails once. The first and the last call of each name fail in every way.
        let all = [kinds[call.call].first(), kinds[call.call].last()].contains(&Some(&n));
        let ways = if all { ways } else { &ways[n % ways.len()..=n % ways.len()] };
        for &kind in ways {
            fail_once(n as u64, call, kind);
            runs += 1;
        }
    }
    println!("{runs} failures");
}

#[test]
fn a_lost_device_is_replaced_by_a_fresh_one() {
    let _turn = turn();
    let (faults, objects) = (Faults::default(), Objects::default());
    faults.inject(Fault { call: "vkWaitSemaphores", skip: 2, result: FaultKind::DeviceLost });
    assert!(matches!(everything(&faults, &objects), Err(Error::DeviceLost(_))));
    assert_eq!(objects.alive(), []);
    assert_eq!(everything(&faults, &objects).unwrap(), expected());
}

#[test]
fn cache_on_disk_failures_are_tolerated() {
    let _turn = turn();
    let folder = tempfile::tempdir().unwrap();
    let (faults, objects) = (Faults::default(), Objects::default());
    let options = DeviceOptions { pipeline_cache: Some(folder.path().to_owned()), ..options(&faults, &objects) };
    for kind in FaultKind::of("vkGetPipelineCacheData") {
        let device = Device::open(&options).unwrap();
        faults.inject(Fault { call: "vkGetPipelineCacheData", skip: 0, result: *kind });
        assert_eq!(workload(&device).unwrap(), expected());
        assert_eq!(faults.take_fired().len(), 1);
        // The file is written later instead.
        drop(device);
        assert_eq!(objects.alive(), []);
        let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        std::fs::remove_file(file).unwrap();
    }
}

/// A process that is killed after its first replay leaves its kernels compiled.
#[test]
fn cache_is_on_disk_after_the_first_replay() {
    let _turn = turn();
    let folder = tempfile::tempdir().unwrap();
    let (faults, objects) = (Faults::default(), Objects::default());
    let options = DeviceOptions { pipeline_cache: Some(folder.path().to_owned()), ..options(&faults, &objects) };
    let device = Device::open(&options).unwrap();
    assert_eq!(workload(&device).unwrap(), expected());
    let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let written = file.metadata().unwrap().modified().unwrap();
    assert_eq!(workload(&device).unwrap(), expected());
    drop(device);
    assert_eq!(file.metadata().unwrap().modified().unwrap(), written, "nothing new was compiled");
}

/// A damaged cache file is rebuilt, and kernels are still created.
#[test]
fn damaged_cache_on_disk_is_rebuilt() {
    let _turn = turn();
    let folder = tempfile::tempdir().unwrap();
    let (faults, objects) = (Faults::default(), Objects::default());
    let options = DeviceOptions { pipeline_cache: Some(folder.path().to_owned()), ..options(&faults, &objects) };
    let run = || {
        let device = Device::open(&options).unwrap();
        assert_eq!(workload(&device).unwrap(), expected());
        assert_eq!(device.messages().take(), Vec::<String>::new());
        drop(device);
        let mut files: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|f| f.unwrap().path()).collect();
        assert_eq!(files.len(), 1, "{files:?}");
        files.remove(0)
    };
    let file = run();
    let whole = std::fs::read(&file).unwrap();
    assert_eq!(run(), file);
    let middle = whole.len() / 2;
    let turned = [&whole[..middle], &[!whole[middle]], &whole[middle + 1..]].concat();
    for damaged in [&[][..], &whole[..middle], &turned, &whole[12..]] {
        std::fs::write(&file, damaged).unwrap();
        run();
        let again = std::fs::read(&file).unwrap();
        assert!(again.starts_with(b"SGSPIPE1") && again != damaged, "it was not written again");
    }
}

#[test]
fn leaked_objects_are_detected() {
    let _turn = turn();
    let (faults, objects) = (Faults::default(), Objects::default());
    let device = Device::open(&options(&faults, &objects)).unwrap();
    std::mem::forget(device.buffer("forgotten", 64, Location::Device).unwrap());
    assert_eq!(lasting(&device, &objects), [(ObjectKind::Buffer, 1), (ObjectKind::Memory, 1)]);
    assert_eq!(device.memory_use().0, 64);
    // `names` rejects an error that names another call, another object, or nothing.
    let call = |call, what: &str| Call { call, what: what.to_owned() };
    faults.inject(Fault { call: "vkCreateBuffer", skip: 0, result: FaultKind::OutOfHostMemory });
    let error = device.buffer("b", 4, Location::Device).unwrap_err();
    assert!(names(&error, &call("vkCreateBuffer", "b"), FaultKind::OutOfHostMemory));
    assert!(!names(&error, &call("vkCreateBuffer", "c"), FaultKind::OutOfHostMemory));
    assert!(!names(&error, &call("vkBindBufferMemory", "b"), FaultKind::OutOfHostMemory));
    assert!(!names(&Error::NoValidation, &call("vkCreateBuffer", "b"), FaultKind::OutOfHostMemory));
}

/// Fallible methods of the Vulkan bindings, with the names of the Vulkan calls.
const FALLIBLE: [(&str, &str); 30] = [
    ("create_instance", "vkCreateInstance"),
    ("create_device", "vkCreateDevice"),
    ("create_debug_utils_messenger", "vkCreateDebugUtilsMessengerEXT"),
    ("enumerate_instance_layer_properties", "vkEnumerateInstanceLayerProperties"),
    ("enumerate_instance_extension_properties", "vkEnumerateInstanceExtensionProperties"),
    ("enumerate_physical_devices", "vkEnumeratePhysicalDevices"),
    ("enumerate_device_extension_properties", "vkEnumerateDeviceExtensionProperties"),
    ("create_buffer", "vkCreateBuffer"),
    ("create_image", "vkCreateImage"),
    ("create_image_view", "vkCreateImageView"),
    ("create_semaphore", "vkCreateSemaphore"),
    ("create_fence", "vkCreateFence"),
    ("create_command_pool", "vkCreateCommandPool"),
    ("create_descriptor_pool", "vkCreateDescriptorPool"),
    ("create_query_pool", "vkCreateQueryPool"),
    ("create_pipeline_cache", "vkCreatePipelineCache"),
    ("create_compute_pipelines", "vkCreateComputePipelines"),
    ("create_pipeline_layout", "vkCreatePipelineLayout"),
    ("create_descriptor_set_layout", "vkCreateDescriptorSetLayout"),
    ("create_shader_module", "vkCreateShaderModule"),
    ("allocate_command_buffers", "vkAllocateCommandBuffers"),
    ("allocate_descriptor_sets", "vkAllocateDescriptorSets"),
    ("bind_buffer_memory", "vkBindBufferMemory"),
    ("bind_image_memory", "vkBindImageMemory"),
    ("begin_command_buffer", "vkBeginCommandBuffer"),
    ("end_command_buffer", "vkEndCommandBuffer"),
    ("reset_command_pool", "vkResetCommandPool"),
    ("queue_submit2", "vkQueueSubmit2"),
    ("get_query_pool_results", "vkGetQueryPoolResults"),
    ("get_semaphore_counter_value", "vkGetSemaphoreCounterValue"),
];

/// Lists fallible calls in a source without a check of the fault gate nearby.
///
/// The check names the call, on the same line or at most four lines above.
fn past_the_gate(source: &str) -> Vec<String> {
    let lines: Vec<&str> = source.lines().collect();
    let mut found = Vec::new();
    for (i, line) in lines.iter().enumerate() {
        let near = lines[i.saturating_sub(4)..=i].join("\n");
        for (method, call) in FALLIBLE {
            if line.contains(&format!(".{method}(")) && !near.contains(&format!("\"{call}\"")) {
                found.push(format!("line {}: {}", i + 1, line.trim()));
            }
        }
    }
    found
}

#[test]
fn every_fallible_call_goes_through_the_gate() {
    let planted = "let pool = unsafe { raw.create_command_pool(&info, None) }?;";
    assert_eq!(past_the_gate(planted).len(), 1);
    let mut open = vec![std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../engine/src")];
    let mut wrong = Vec::new();
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let found = past_the_gate(&std::fs::read_to_string(&path).unwrap());
                wrong.extend(found.into_iter().map(|f| format!("{}: {f}", path.display())));
            }
        }
    }
    assert_eq!(wrong, Vec::<String>::new());
}

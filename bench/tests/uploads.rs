//! Uploads through a queue that only transfers, with validation.
//!
//! Of the devices of tests only the null driver has such a queue. It executes copies, so that their bytes can be compared. The
//! validation layer checks the use of both queues.

use sgs_engine::device::{Fault, FaultKind, Faults, Objects};
use sgs_engine::{Device, DeviceOptions, Location};
use sgs_null_driver::{BYTES, Counter, FILE_VARIABLE, manifest, read};
use std::path::Path;
use std::process::Command;

/// Variable with the file of counts, in the process that has the null driver.
const CHILD: &str = "SGS_TEST_NULL_DRIVER";

fn pattern(bytes: usize) -> Vec<u8> {
    (0..bytes as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect()
}

/// Uploads on the null driver. Runs in a process of its own.
fn upload(counts: &Path) {
    let device = Device::open(&DeviceOptions { validation: true, ..Default::default() }).unwrap();
    assert_eq!(device.info().name, "null driver");
    let submits = || read(counts).unwrap()[Counter::TransferSubmits as usize];
    let chunks = 10;
    let data = pattern((chunks << 20) - 3);
    let buffer = device.buffer("target", data.len() as u64 + (1 << 20), Location::Device).unwrap();
    device.fill(&buffer, 7).unwrap();
    assert_eq!(submits(), 0);
    device.upload(&buffer, 5, &data).unwrap();
    assert_eq!(submits(), chunks as u64);
    assert_eq!(device.activity().most_chunks_in_flight, 4);
    // Copies are done before their staging memory is used again, so that only the end waits.
    assert_eq!((device.activity().upload_chunks, device.activity().upload_waits), (chunks as u64, 1));
    let found = device.download(&buffer, 0, buffer.bytes()).unwrap();
    assert!(found[5..][..data.len()] == data, "other bytes arrived");
    assert_eq!(found[..4], [7, 0, 0, 0]);
    // Several pieces, twice into the same ranges: the second upload waits for the first.
    for seed in 0..2 {
        let other: Vec<u8> = data.iter().map(|byte| byte ^ seed).collect();
        let (a, b) = other.split_at(3 << 20);
        device.upload_all(&[(&buffer, 0, a), (&buffer, 4 << 20, b)]).unwrap();
        let found = device.download(&buffer, 0, buffer.bytes()).unwrap();
        assert!(found[..a.len()] == *a && found[4 << 20..][..b.len()] == *b, "other bytes arrived");
    }
    // Small data take the main queue.
    let before = submits();
    device.upload(&buffer, 0, &data[..1000]).unwrap();
    assert_eq!(submits(), before);
    let (messages, objects) = (device.messages().clone(), device.objects().clone());
    drop(buffer);
    drop(device);
    assert_eq!(messages.take(), Vec::<String>::new());
    assert_eq!(objects.alive(), []);
}

/// Fails each call of an upload once. Nothing may be left, and only the failed upload may report an error.
fn fail_each_call() {
    let open = |faults: &Faults, objects: &Objects| {
        let (faults, objects) = (faults.clone(), objects.clone());
        Device::open(&DeviceOptions { validation: true, faults, objects, ..Default::default() }).unwrap()
    };
    let data = pattern(6 << 20);
    let work = |device: &Device| {
        let buffer = device.buffer("target", data.len() as u64, Location::Device)?;
        device.upload(&buffer, 0, &data)
    };
    let recorded = Faults::default();
    let device = open(&recorded, &Objects::default());
    recorded.record();
    work(&device).unwrap();
    let calls = recorded.take_record();
    drop(device);
    assert!(calls.iter().filter(|call| call.call == "vkQueueSubmit2").count() == 7, "{calls:?}");
    for (n, call) in calls.iter().enumerate() {
        for kind in FaultKind::of(call.call) {
            let context = format!("{} for \"{}\", {kind:?}", call.call, call.what);
            let (faults, objects) = (Faults::default(), Objects::default());
            let device = open(&faults, &objects);
            let messages = device.messages().clone();
            faults.inject(Fault { call: Fault::ANY, skip: n as u64, result: *kind });
            let failed = work(&device).is_err();
            assert!(failed || call.call == "vkSetDebugUtilsObjectNameEXT", "{context}: nobody noticed");
            if *kind != FaultKind::DeviceLost {
                device.wait(device.last_ticket(), "the rest").unwrap();
                assert_eq!((device.collect(), device.memory_use().0), (0, 0), "{context}");
                work(&device).unwrap();
            }
            drop(device);
            assert_eq!(objects.alive(), [], "{context}");
            assert_eq!(messages.take(), Vec::<String>::new(), "{context}");
        }
    }
}

#[test]
fn large_uploads_take_the_transfer_queue() {
    if let Some(counts) = std::env::var_os(CHILD) {
        upload(Path::new(&counts));
        return fail_each_call();
    }
    let test = std::env::current_exe().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let [json, counts] = ["null.json", "counts"].map(|name| folder.path().join(name));
    let library = test.with_file_name("libsgs_null_driver.so");
    std::fs::write(&json, manifest(&library)).unwrap();
    std::fs::write(&counts, [0; BYTES]).unwrap();
    let mut child = Command::new(&test);
    child.args(["--exact", "large_uploads_take_the_transfer_queue", "--nocapture"]);
    child.env(CHILD, &counts).env(FILE_VARIABLE, &counts).env("VK_DRIVER_FILES", &json).env("VK_ICD_FILENAMES", &json);
    // Across submissions, layer 1.3.239 knows no timeline semaphores, by which the queues wait for each other and the host for
    // both: it reports every pair of accesses. Within command buffers it checks barriers and transfers of ownership.
    child.env_remove("VK_LAYER_ENABLES");
    let out = child.output().unwrap();
    let text = [&out.stdout[..], &out.stderr].map(String::from_utf8_lossy).concat();
    assert!(out.status.success(), "{text}");
    assert!(read(&counts).unwrap()[Counter::TransferSubmits as usize] > 20, "the child has not uploaded: {text}");
}

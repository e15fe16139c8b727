//! Plans in a host's command buffers and between its semaphores; shared memory.

use ash::vk;
use sgs_embedding::Host;
use sgs_engine::exec::{Completion, ExecOptions, Executor, SemaphorePoint};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceOptions, Error, ImageFormat, Location};
use sgs_passes::kernel::stage;
use sgs_shaders::regroup;
use sgs_shaders::structs::Work;
use std::sync::Arc;

/// Plan whose kernel divides the count in `work` into groups of a fixed size.
///
/// The plan uses a transient and writes the next count next to the groups, so it can be replayed on its own result.
struct Groups {
    exec: Executor,
    work: Buffer,
    out: Buffer,
}

fn plan(device: &Device, frames: usize) -> Groups {
    let mut g = Graph::new("groups");
    let work = g.external("work", 16);
    let out = g.external("out", 16);
    let between = g.transient("between", 16);
    let bindings = regroup::Bindings { work: work.into(), regrouped: between.into() };
    let push = regroup::Push { group_size: 10 };
    stage(&mut g, "regroup", &regroup::KERNEL, bindings.entries(), [], bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])
        .unwrap();
    g.copy("copy", between, out).unwrap();
    let plan = Arc::new(g.compile(&CompileOptions::default()).unwrap());
    let options = ExecOptions { frames_in_flight: frames, poison: true, ..Default::default() };
    Groups { exec: Executor::new(device, plan, options).unwrap(), work, out }
}

fn words(w: [u32; 4]) -> Vec<u8> {
    bytemuck::cast_slice(&w).to_vec()
}

fn count(n: u32) -> Vec<u8> {
    words([0, 0, 0, n])
}

#[test]
fn a_plan_runs_between_a_hosts_commands_on_the_hosts_buffers() {
    let host = Host::new();
    // The host submits everything itself.
    // SAFETY: the host's description is true.
    let device = unsafe { Device::adopt(host.offer(false)) }.unwrap();
    let (upload, input, output, back) = (host.buffer(16), host.buffer(16), host.buffer(16), host.buffer(16));
    host.write(&upload, &count(95));
    let mut groups = plan(&device, 2);
    // SAFETY: the buffers outlive the plan and belong to this device.
    unsafe {
        groups.exec.bind(groups.work, &device.wrap_buffer("in", input.raw, 16).unwrap()).unwrap();
        groups.exec.bind(groups.out, &device.wrap_buffer("out", output.raw, 16).unwrap()).unwrap();
    }
    let commands = host.begin();
    let region = [vk::BufferCopy { size: 16, ..Default::default() }];
    // The host copies before and after without barriers of its own: the plan's entry and exit synchronize.
    // SAFETY: everything is alive and belongs to one device; the commands are run once, below.
    let recorded = unsafe {
        host.device.cmd_copy_buffer(commands, upload.raw, input.raw, &region);
        let recorded = groups.exec.record_into(commands, &[]).unwrap();
        host.device.cmd_copy_buffer(commands, output.raw, back.raw, &region);
        recorded
    };
    host.run(commands);
    assert_eq!(host.read(&back, 16), words([10, 1, 1, 95]));
    // SAFETY: `run` has waited.
    unsafe { recorded.release() };
    drop(groups);
    for buffer in [upload, input, output, back] {
        host.destroy_buffer(buffer);
    }
}

#[test]
fn held_slots_are_not_reused() {
    let host = Host::new();
    let device = host.adopt();
    let mut groups = plan(&device, 2);
    let memory = [count(20), count(0)].map(|data| {
        let buffer = device.buffer("work", 16, Location::Device).unwrap();
        device.upload(&buffer, 0, &data).unwrap();
        buffer
    });
    groups.exec.bind(groups.work, &memory[0]).unwrap();
    groups.exec.bind(groups.out, &memory[1]).unwrap();
    let commands = host.begin();
    // SAFETY: the commands are submitted once, below.
    let (one, two) =
        unsafe { (groups.exec.record_into(commands, &[]).unwrap(), groups.exec.record_into(commands, &[]).unwrap()) };
    // SAFETY: this call records nothing.
    let error = unsafe { groups.exec.record_into(commands, &[]) }.unwrap_err();
    assert!(matches!(error, Error::SlotsInUse { slots: 2, .. }), "{error}");
    assert_eq!(groups.exec.recordings().unwrap(), 2);
    let timeline = host.semaphore(true);
    let fence = host.fence();
    let signal = [vk::SemaphoreSubmitInfo::default()
        .semaphore(timeline)
        .value(5)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)];
    // SAFETY: the semaphore covers the first recording, the fence the second; both live until the end.
    unsafe {
        one.until(Completion::Timeline(timeline, 5));
        two.until(Completion::Fence(fence));
    }
    // The commands are not submitted yet, so the recordings are not done.
    assert_eq!(groups.exec.recordings().unwrap(), 2);
    host.submit(commands, &[], &signal, fence);
    let (semaphores, values) = ([timeline], [5]);
    let both = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
    // SAFETY: semaphore and fence are alive. Either may be signaled first.
    unsafe {
        host.device.wait_semaphores(&both, u64::MAX).unwrap();
        host.device.wait_for_fences(&[fence], true, u64::MAX).unwrap();
    }
    assert_eq!(groups.exec.recordings().unwrap(), 0);
    let commands = host.begin();
    // SAFETY: the commands are run once, below.
    let again = unsafe { groups.exec.record_into(commands, &[]) }.unwrap();
    // Binding again must not free memory that a recording uses.
    let other = device.buffer("other", 16, Location::Device).unwrap();
    device.upload(&other, 0, &count(41)).unwrap();
    drop(memory);
    groups.exec.bind(groups.work, &other).unwrap();
    host.run(commands);
    // SAFETY: `run` has waited.
    unsafe { again.release() };
    drop(groups);
    host.wait(fence);
    host.destroy_semaphore(timeline);
}

#[test]
fn dropping_a_plan_waits_for_its_recordings() {
    let host = Host::new();
    let device = host.adopt();
    let timeline = host.semaphore(true);
    let mut groups = plan(&device, 1);
    for buffer in [groups.work, groups.out] {
        let memory = device.buffer("b", 16, Location::Device).unwrap();
        device.fill(&memory, 1).unwrap();
        groups.exec.bind(buffer, &memory).unwrap();
    }
    let commands = host.begin();
    let signal = [vk::SemaphoreSubmitInfo::default()
        .semaphore(timeline)
        .value(1)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)];
    // SAFETY: the semaphore covers the submission and outlives the plan.
    unsafe { groups.exec.record_into(commands, &[]).unwrap().until(Completion::Timeline(timeline, 1)) };
    host.submit(commands, &[], &signal, vk::Fence::null());
    drop(groups);
    // Validation would report command pools that are destroyed while in use.
    // SAFETY: the semaphore is alive.
    assert_eq!(unsafe { host.device.get_semaphore_counter_value(timeline) }.unwrap(), 1);
    drop(device);
    host.destroy_semaphore(timeline);
}

#[test]
fn submissions_wait_for_and_signal_a_hosts_semaphores() {
    let host = Host::new();
    let device = host.adopt();
    let (timeline, binary) = (host.semaphore(true), host.semaphore(false));
    let (upload, input, back) = (host.buffer(16), host.buffer(16), host.buffer(16));
    host.write(&upload, &count(31));
    let mut groups = plan(&device, 2);
    let out = device.buffer("out", 16, Location::Device).unwrap();
    // SAFETY: the buffer outlives the plan.
    unsafe { groups.exec.bind(groups.work, &device.wrap_buffer("in", input.raw, 16).unwrap()).unwrap() };
    groups.exec.bind(groups.out, &out).unwrap();
    let at = |semaphore, value| {
        vk::SemaphoreSubmitInfo::default()
            .semaphore(semaphore)
            .value(value)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
    };
    let region = [vk::BufferCopy { size: 16, ..Default::default() }];
    let first = host.begin();
    // SAFETY: everything is alive.
    unsafe { host.device.cmd_copy_buffer(first, upload.raw, input.raw, &region) };
    host.submit(first, &[], &[at(timeline, 1), at(binary, 0)], vk::Fence::null());
    // SAFETY: the host's signals are submitted; the engine's value is new.
    let ticket = unsafe {
        groups.exec.submit_with(
            &[],
            &[SemaphorePoint::timeline(timeline, 1), SemaphorePoint::binary(binary)],
            &[SemaphorePoint::timeline(timeline, 2)],
        )
    }
    .unwrap();
    let last = host.begin();
    // SAFETY: as above.
    unsafe { host.device.cmd_copy_buffer(last, out.raw(), back.raw, &region) };
    let fence = host.fence();
    host.submit(last, &[at(timeline, 2)], &[], fence);
    host.wait(fence);
    assert_eq!(host.read(&back, 16), words([4, 1, 1, 31]));
    assert!(device.is_done(ticket).unwrap());
    drop(groups);
    [upload, input, back].into_iter().for_each(|b| host.destroy_buffer(b));
    host.destroy_semaphore(timeline);
    host.destroy_semaphore(binary);
}

#[test]
fn null_handles_are_refused() {
    let host = Host::new();
    let device = host.adopt();
    let mut groups = plan(&device, 1);
    // SAFETY: null handles are refused before they are used.
    unsafe {
        assert!(matches!(groups.exec.record_into(vk::CommandBuffer::null(), &[]), Err(Error::Host(_))));
        assert!(matches!(device.wrap_buffer("b", vk::Buffer::null(), 4), Err(Error::Host(_))));
        let image = device.wrap_image("i", vk::Image::null(), [1, 1], ImageFormat::Rgba8Unorm, false);
        assert!(matches!(image, Err(Error::Host(_))));
    }
}

/// Opens a device of the test, within the turn of its host.
fn own() -> Device {
    let options =
        DeviceOptions { select: std::env::var("SGS_TEST_DEVICE").ok(), validation: true, ..Default::default() };
    Device::open(&options).unwrap()
}

#[test]
fn another_device_reads_shared_memory_or_it_is_refused_by_name() {
    let host = Host::new();
    let (from, to) = (host.adopt(), own());
    if !from.info().optional.external_memory_fd {
        let error = from.shared_buffer("b", 64).unwrap_err();
        assert!(error.to_string().contains("VK_KHR_external_memory_fd"), "{error}");
        return;
    }
    let data: Vec<u8> = (0..4096u32).map(|i| (i * 7) as u8).collect();
    let buffer = from.shared_buffer("shared", 4096).unwrap();
    from.upload(&buffer, 0, &data).unwrap();
    // SAFETY: both devices are of one driver and one physical device; all work is waited for.
    let imported = unsafe { to.import_buffer("shared", 4096, buffer.export().unwrap()) }.unwrap();
    assert_eq!(to.download(&imported, 0, 4096).unwrap(), data);
    to.fill(&imported, 0x0102_0304).unwrap();
    assert!(from.download_as::<u32>(&buffer, 1024).unwrap().iter().all(|w| *w == 0x0102_0304));
    // The memory outlives its first owner.
    drop(buffer);
    assert!(to.download_as::<u32>(&imported, 1024).unwrap().iter().all(|w| *w == 0x0102_0304));

    let image = from.shared_image("image", [16, 8], ImageFormat::Rgba8Unorm).unwrap();
    let texels: Vec<u8> = (0..16 * 8 * 4).map(|i| (i * 3) as u8).collect();
    from.upload_image(&image, &texels).unwrap();
    let handle = image.export().unwrap();
    assert!(handle.bytes >= image.packed_bytes());
    // SAFETY: as above; the image is in the general layout on both sides.
    let imported = unsafe { to.import_image("image", [16, 8], ImageFormat::Rgba8Unorm, handle) }.unwrap();
    assert_eq!(imported.size(), [16, 8]);
    drop(imported);
    let plain = from.buffer("plain", 64, Location::Device).unwrap();
    assert!(matches!(plain.export(), Err(Error::NotShared(name)) if name == "plain"));
    assert_eq!(to.messages().take(), Vec::<String>::new());
}

#[test]
fn shared_semaphores_work_or_are_refused_by_name() {
    let host = Host::new();
    let (from, to) = (host.adopt(), own());
    if !from.info().optional.external_semaphore_fd {
        let error = from.shared_semaphore("s", true).err().expect("it is refused");
        assert!(matches!(&error, Error::MissingExtension { extension: "VK_KHR_external_semaphore_fd", .. }), "{error}");
        return;
    }
    let semaphore = from.shared_semaphore("s", true).unwrap();
    // SAFETY: both devices are of one driver and one physical device.
    let imported = unsafe { to.import_semaphore("s", true, semaphore.export().unwrap()) }.unwrap();
    let mut groups = plan(&from, 1);
    let mut others = plan(&to, 1);
    for (device, groups) in [(&from, &mut groups), (&to, &mut others)] {
        for buffer in [groups.work, groups.out] {
            let memory = device.buffer("b", 16, Location::Device).unwrap();
            device.fill(&memory, 1).unwrap();
            groups.exec.bind(buffer, &memory).unwrap();
        }
    }
    // SAFETY: the signal is submitted first; both semaphores outlive the work.
    unsafe {
        groups.exec.submit_with(&[], &[], &[SemaphorePoint::timeline(semaphore.raw(), 3)]).unwrap();
        others.exec.submit_with(&[], &[SemaphorePoint::timeline(imported.raw(), 3)], &[]).unwrap();
    }
    others.exec.finish().unwrap();
    groups.exec.finish().unwrap();
}

#[test]
fn work_struct_has_the_expected_layout() {
    assert_eq!(bytemuck::bytes_of(&Work { x: 1, y: 2, z: 3, count: 4 }).to_vec(), words([1, 2, 3, 4]));
}

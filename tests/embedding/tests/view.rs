//! Views in a host's own images, between the host's own commands.

use ash::vk;
use sgs_embedding::{Host, Owned};
use sgs_engine::exec::{Completion, Recording, SemaphorePoint};
use sgs_engine::graph::ImageState;
use sgs_engine::{Device, DeviceImage, Error, ImageFormat};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Frame, Renderer, View, ViewError, ViewOptions};
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{Channels, Encoding, Layer, Presented, TexelFormat};
use sgs_tests::scenes;
use vk::ImageLayout as L;

const SIZE: [u32; 2] = [64, 48];
const BYTES: u64 = 64 * 48 * 4;

struct Engine {
    device: Device,
    gaussians: Gaussians,
    view: View,
}

fn engine(host: &Host, frames: usize, capacity: u32) -> Engine {
    let device = host.adopt();
    let gaussians =
        Gaussians::new(&device, Model { sh_degree: 3, normals: false, ..Default::default() }, 300, false).unwrap();
    gaussians.upload(&device, &scenes::data(&scenes::ordinary(300, 3, false, 4))).unwrap();
    let options = ViewOptions {
        size: SIZE,
        presented: Presented {
            layer: Layer::Color,
            format: TexelFormat::Rgba8Unorm,
            encoding: Encoding::Display,
            depth_scale: 1.0,
        },
        entry: ImageState::TransferTarget,
        exit: ImageState::TransferSource,
        frames_in_flight: frames,
        entry_capacity: capacity,
    };
    let view = View::new(&device, Tuning::for_device(device.info()), &gaussians, options).unwrap();
    Engine { device, gaussians, view }
}

fn frame(k: u32) -> Frame {
    let mut camera = scenes::gpu_camera(&scenes::camera(SIZE));
    camera.center[0] += 2.0 * k as f32;
    Frame { camera, sh_degree: 3, background: [0.2, 0.0, 0.4] }
}

/// Renders a frame with the engine's own renderer, as RGBA8 bytes.
fn expected(e: &Engine, k: u32) -> Vec<u8> {
    let channels = Channels { colors: true, normals: false, depth: false };
    let tuning = Tuning::for_device(e.device.info());
    let mut renderer = Renderer::new(&e.device, tuning, &e.gaussians, SIZE, channels).unwrap();
    let f = frame(k);
    let rendered = renderer.render(&e.gaussians, &f.camera, 3, f.background).unwrap();
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let texel = |(c, t): (&[f32], &f32)| [byte(c[0]), byte(c[1]), byte(c[2]), byte(1.0 - t)];
    rendered.image.chunks(3).zip(&rendered.transmittance).flat_map(texel).collect()
}

fn wrap(device: &Device, image: &Owned<vk::Image>) -> DeviceImage {
    // SAFETY: the host made the image with this size and format for copies both ways, and destroys it after the engine.
    unsafe { device.wrap_image("host's image", image.raw, SIZE, ImageFormat::Rgba8Unorm, false) }.unwrap()
}

fn record(e: &mut Engine, commands: vk::CommandBuffer, image: &DeviceImage, k: u32) -> Result<Recording, ViewError> {
    e.view.frame(&e.gaussians, image, &frame(k), |exec, uniforms| {
        // SAFETY: the commands are being recorded by this thread and run once; the image is in the entry's layout.
        unsafe { exec.record_into(commands, uniforms) }
    })
}

#[test]
fn frames_are_recorded_between_a_hosts_commands() {
    let host = Host::new();
    let mut e = engine(&host, 2, 0);
    let images = [host.image(SIZE, vk::Format::R8G8B8A8_UNORM), host.image(SIZE, vk::Format::R8G8B8A8_UNORM)];
    let wrapped = [wrap(&e.device, &images[0]), wrap(&e.device, &images[1])];
    let back: Vec<_> = (0..6).map(|_| host.buffer(BYTES)).collect();
    let cleared = host.buffer(BYTES);
    let timeline = host.semaphore(true);
    let submissions = host.lock.taken.load(std::sync::atomic::Ordering::SeqCst);
    for k in 0..6u32 {
        // With two frames in flight, the frame before the last must be done before its slot is reused.
        if k >= 2 {
            let (s, v) = ([timeline], [u64::from(k) - 1]);
            let info = vk::SemaphoreWaitInfo::default().semaphores(&s).values(&v);
            // SAFETY: alive.
            unsafe { host.device.wait_semaphores(&info, u64::MAX) }.unwrap();
        }
        let image = &images[k as usize % 2];
        let commands = host.begin();
        // The host draws first and reads its result.
        host.transition(commands, image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
        host.clear(commands, image.raw, [1.0, 0.0, 0.0, 1.0]);
        host.transition(commands, image.raw, L::TRANSFER_DST_OPTIMAL, L::TRANSFER_SRC_OPTIMAL);
        host.read_image(commands, image.raw, SIZE, cleared.raw);
        host.transition(commands, image.raw, L::TRANSFER_SRC_OPTIMAL, L::TRANSFER_DST_OPTIMAL);
        let recorded = record(&mut e, commands, &wrapped[k as usize % 2], k).unwrap();
        host.read_image(commands, image.raw, SIZE, back[k as usize].raw);
        let done = [vk::SemaphoreSubmitInfo::default()
            .semaphore(timeline)
            .value(u64::from(k) + 1)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)];
        host.submit(commands, &[], &done, vk::Fence::null());
        // SAFETY: the value covers the submission; the semaphore outlives the view.
        unsafe { recorded.until(Completion::Timeline(timeline, u64::from(k) + 1)) };
    }
    let (s, v) = ([timeline], [6]);
    let info = vk::SemaphoreWaitInfo::default().semaphores(&s).values(&v);
    // SAFETY: alive.
    unsafe { host.device.wait_semaphores(&info, u64::MAX) }.unwrap();
    let after = host.lock.taken.load(std::sync::atomic::Ordering::SeqCst);
    assert_eq!(after - submissions, 6, "the engine has submitted something of its own");
    assert!(host.read(&cleared, BYTES).chunks(4).all(|t| t == [255, 0, 0, 255]));
    for (k, buffer) in (0..).zip(&back) {
        assert!(host.read(buffer, BYTES) == expected(&e, k), "frame {k} differs");
    }
    assert_ne!(expected(&e, 0), expected(&e, 5));
    let report = e.view.report().unwrap();
    assert_eq!((report.frames, report.incomplete), (6, 0));
    drop((e, wrapped));
    back.into_iter().chain([cleared]).for_each(|b| host.destroy_buffer(b));
    images.into_iter().for_each(|i| host.destroy_image(i));
    host.destroy_semaphore(timeline);
}

#[test]
fn a_frame_is_submitted_between_a_hosts_semaphores() {
    let host = Host::new();
    let mut e = engine(&host, 1, 0);
    let (image, back) = (host.image(SIZE, vk::Format::R8G8B8A8_UNORM), host.buffer(BYTES));
    let wrapped = wrap(&e.device, &image);
    let timeline = host.semaphore(true);
    let at = |value| {
        [vk::SemaphoreSubmitInfo::default()
            .semaphore(timeline)
            .value(value)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)]
    };
    let commands = host.begin();
    host.transition(commands, image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
    host.submit(commands, &[], &at(1), vk::Fence::null());
    let submitted = e.view.frame(&e.gaussians, &wrapped, &frame(3), |exec, uniforms| {
        let (wait, signal) = ([SemaphorePoint::timeline(timeline, 1)], [SemaphorePoint::timeline(timeline, 2)]);
        // SAFETY: the host's signal is on its way; 2 is new.
        unsafe { exec.submit_with(uniforms, &wait, &signal) }
    });
    submitted.unwrap();
    let commands = host.begin();
    host.read_image(commands, image.raw, SIZE, back.raw);
    let fence = host.fence();
    host.submit(commands, &at(2), &[], fence);
    host.wait(fence);
    assert!(host.read(&back, BYTES) == expected(&e, 3));
    drop((e, wrapped));
    host.destroy_buffer(back);
    host.destroy_image(image);
    host.destroy_semaphore(timeline);
}

#[test]
fn capacity_grows_while_the_host_holds_recordings() {
    let host = Host::new();
    let mut e = engine(&host, 1, 16);
    let (image, back) = (host.image(SIZE, vk::Format::R8G8B8A8_UNORM), host.buffer(BYTES));
    let wrapped = wrap(&e.device, &image);
    let shot = |e: &mut Engine, k: u32| {
        let commands = host.begin();
        host.transition(commands, image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
        let recorded = record(e, commands, &wrapped, k).unwrap();
        host.read_image(commands, image.raw, SIZE, back.raw);
        host.run(commands);
        (recorded, host.read(&back, BYTES))
    };
    let (first, background) = shot(&mut e, 0);
    assert!(background.chunks(4).all(|t| t == [51, 0, 102, 0]));
    // The first recording still holds its slot; the plan with more capacity has slots of its own.
    let (second, displayed) = shot(&mut e, 0);
    assert!(displayed == expected(&e, 0));
    assert_eq!(e.view.recordings().unwrap(), 2);
    let commands = host.begin();
    host.transition(commands, image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
    let error = record(&mut e, commands, &wrapped, 0).err();
    assert!(matches!(error, Some(ViewError::Engine(Error::SlotsInUse { slots: 1, .. }))), "{error:?}");
    host.run(commands);
    // SAFETY: every submission has been waited for.
    unsafe {
        first.release();
        second.release();
    }
    let (third, _) = shot(&mut e, 1);
    assert_eq!(e.view.recordings().unwrap(), 1);
    // SAFETY: as above.
    unsafe { third.release() };
    drop((e, wrapped));
    host.destroy_buffer(back);
    host.destroy_image(image);
}

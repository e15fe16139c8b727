//! An application with a Vulkan device of its own that shows splats in its own image, frame by frame.
//!
//!     cargo run -p sgs-embedding --example host
//!
//! `Host` is the application: its instance and device made with `ash`, its queue behind its own lock, its image, its
//! commands. What it says to the engine is in this file: adopt, wrap, record, and when a recording is done.

use ash::vk;
use sgs_embedding::Host;
use sgs_engine::ImageFormat;
use sgs_engine::graph::ImageState;
use sgs_engine::graph::exec::Until;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Frame, Renderer, View, ViewOptions};
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{Channels, Encoding, Layer, Presented, TexelFormat};
use sgs_tests::scenes;
use vk::ImageLayout as L;

const SIZE: [u32; 2] = [80, 60];

/// Shows some frames; returns how many texels the application's own renderer gives otherwise.
pub fn run(frames: u64) -> usize {
    // The host makes its device with what `requirements` asked for.
    let host = Host::new();
    let image = host.image(SIZE, vk::Format::B8G8R8A8_SRGB);
    let back = host.buffer(u64::from(SIZE[0] * SIZE[1] * 4));
    let timeline = host.semaphore(true);

    // SAFETY: instance, device and queue are the host's, live longer than the engine, and are as stated.
    let device = unsafe { sgs_engine::Device::adopt(host.offer(true)) }.expect("the device fits");
    let model = Model { sh_degree: 2, normals: false, ..Default::default() };
    let gaussians = Gaussians::new(&device, model, 250, false).expect("memory");
    gaussians.upload(&device, &scenes::data(&scenes::ordinary(250, 2, false, 3))).expect("an upload");
    let options = ViewOptions {
        size: SIZE,
        presented: Presented {
            layer: Layer::Color,
            format: TexelFormat::Bgra8Srgb,
            encoding: Encoding::Display,
            depth_scale: 1.0,
        },
        entry: ImageState::TransferTarget,
        exit: ImageState::TransferSource,
        frames_in_flight: 2,
        entry_capacity: 0,
    };
    let tuning = Tuning::for_device(device.info());
    let mut view = View::new(&device, tuning, &gaussians, options).expect("a view");
    // SAFETY: the image has this size and format, and lives until the engine is gone.
    let target =
        unsafe { device.wrap_image("window", image.raw, SIZE, ImageFormat::Bgra8Srgb, false) }.expect("it fits");

    let mut differ = 0;
    for k in 1..=frames {
        let mut camera = scenes::gpu_camera(&scenes::camera(SIZE));
        camera.center[0] += k as f32;
        let frame = Frame { camera, sh_degree: 2, background: [0.0, 0.1, 0.3] };
        let commands = host.begin();
        // The host draws.
        host.transition(commands, image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
        host.clear(commands, image.raw, [1.0, 0.0, 1.0, 1.0]);
        // The engine draws over it, in the same command buffer.
        let recorded = view.frame(&gaussians, &target, &frame, |exec, uniforms| {
            // SAFETY: the commands are being recorded here and submitted once; the image is in the entry's layout.
            unsafe { exec.record_into(commands, uniforms) }
        });
        // The host goes on.
        host.read_image(commands, image.raw, SIZE, back.raw);
        let done = vk::SemaphoreSubmitInfo::default()
            .semaphore(timeline)
            .value(k)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS);
        host.submit(commands, &[], &[done], vk::Fence::null());
        // SAFETY: the submission is done when the semaphore has this value.
        unsafe { recorded.expect("a slot is free").until(Until::Timeline(timeline, k)) };
        let (semaphores, values) = ([timeline], [k]);
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is alive.
        unsafe { host.device.wait_semaphores(&wait, u64::MAX) }.expect("done");

        // The same picture, in between, by way of the engine's own submissions.
        let channels = Channels { colors: true, normals: false, depth: false };
        let mut renderer = Renderer::new(&device, tuning, &gaussians, SIZE, channels).expect("memory");
        let picture = renderer.render(&gaussians, &frame.camera, 2, frame.background).expect("a picture");
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let shown = host.read(&back, u64::from(SIZE[0] * SIZE[1] * 4));
        for ((texel, c), t) in shown.chunks(4).zip(picture.image.chunks(3)).zip(&picture.transmittance) {
            differ += usize::from(texel != [byte(c[2]), byte(c[1]), byte(c[0]), byte(1.0 - t)]);
        }
    }
    drop((view, target, gaussians, device));
    host.destroy_buffer(back);
    host.destroy_image(image);
    host.destroy_semaphore(timeline);
    differ
}

#[allow(dead_code)] // The tests call `run`.
fn main() {
    let differ = run(5);
    println!("5 frames, {differ} texels differ");
    assert_eq!(differ, 0);
}

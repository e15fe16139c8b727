//! Application with its own Vulkan device that shows splats in its own image.
//!
//!     cargo run -p sgs-embedding --example host [RUN]
//!
//! `run` shows splats. `relight` shows a run with trained materials under changing light.
//!
//! `Host` is the application: its instance and device made with `ash`, its queue behind its own lock, its image and its
//! commands. This file holds all calls to the engine: adopt, wrap, record and complete a recording.

use ash::vk;
use sgs_embedding::Host;
use sgs_engine::ImageFormat;
use sgs_engine::exec::Completion;
use sgs_engine::graph::ImageState;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Frame, LitFrame, LitLayer, LitOptions, LitView, Renderer, View, ViewOptions};
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{Channels, Encoding, Layer, Presented, TexelFormat};
use sgs_relight::{Edit, Relighter};
use sgs_run::Shading;
use sgs_tests::scenes;
use std::path::Path;
use vk::ImageLayout as L;

const SIZE: [u32; 2] = [80, 60];

/// Shows `frames` frames.
///
/// Returns the number of texels that differ from the engine's own submission.
pub fn run(frames: u64) -> usize {
    // The host creates its device as `requirements` states.
    let host = Host::new();
    let image = host.image(SIZE, vk::Format::B8G8R8A8_SRGB);
    let back = host.buffer(u64::from(SIZE[0] * SIZE[1] * 4));
    let timeline = host.semaphore(true);

    // SAFETY: instance, device and queue are the host's, outlive the engine, and match the description.
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
    // SAFETY: the image has this size and format, and outlives the engine.
    let target =
        unsafe { device.wrap_image("window", image.raw, SIZE, ImageFormat::Bgra8Srgb, false) }.expect("it fits");

    let mut differ = 0;
    for k in 1..=frames {
        let mut camera = scenes::gpu_camera(&scenes::camera(SIZE));
        camera.center[0] += k as f32;
        let frame = Frame { camera, sh_degree: 2, background: [0.0, 0.1, 0.3] };
        let commands = host.begin();
        // The host draws first.
        host.transition(commands, image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
        host.clear(commands, image.raw, [1.0, 0.0, 1.0, 1.0]);
        // The engine draws over it, in the same command buffer.
        let recorded = view.frame(&gaussians, &target, &frame, |exec, uniforms| {
            // SAFETY: the commands are being recorded here and submitted once; the image is in the entry's layout.
            unsafe { exec.record_into(commands, uniforms) }
        });
        // The host continues.
        host.read_image(commands, image.raw, SIZE, back.raw);
        let done = vk::SemaphoreSubmitInfo::default()
            .semaphore(timeline)
            .value(k)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS);
        host.submit(commands, &[], &[done], vk::Fence::null());
        // SAFETY: the submission is done when the semaphore has this value.
        unsafe { recorded.expect("a slot is free").until(Completion::Timeline(timeline, k)) };
        let (semaphores, values) = ([timeline], [k]);
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is alive.
        unsafe { host.device.wait_semaphores(&wait, u64::MAX) }.expect("done");

        // The reference is the engine's own submission of the same view.
        let channels = Channels { colors: true, normals: false, depth: false };
        let mut renderer = Renderer::new(&device, tuning, &gaussians, SIZE, channels).expect("memory");
        let rendered = renderer.render(&gaussians, &frame.camera, 2, frame.background).expect("an image");
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let displayed = host.read(&back, u64::from(SIZE[0] * SIZE[1] * 4));
        for ((texel, c), t) in displayed.chunks(4).zip(rendered.image.chunks(3)).zip(&rendered.transmittance) {
            differ += usize::from(texel != [byte(c[2]), byte(c[1]), byte(c[0]), byte(1.0 - t)]);
        }
    }
    drop((view, target, gaussians, device));
    host.destroy_buffer(back);
    host.destroy_image(image);
    host.destroy_semaphore(timeline);
    differ
}

/// Relights a run whose materials were trained, one light at a time.
///
/// Shows the run under all light, without one light, under that light alone, and with that light moved. Returns three
/// maximum differences, relative to the largest value. The first compares the first two images with `sgs relight`. The
/// second compares the first image with the sum of the second and the third. The third compares the last two images.
pub fn relight(directory: &Path) -> [f32; 3] {
    let host = Host::new();
    let format = vk::Format::R32G32B32A32_SFLOAT;
    let (image, bytes) = (host.image(SIZE, format), u64::from(SIZE[0] * SIZE[1] * 16));
    let back = host.buffer(bytes);
    // SAFETY: as above.
    let device = unsafe { sgs_engine::Device::adopt(host.offer(true)) }.expect("the device fits");
    // SAFETY: as above.
    let target = unsafe { device.wrap_image("window", image.raw, SIZE, ImageFormat::Rgba32Float, false) };
    let target = target.expect("it fits");
    let mut run = Relighter::open(&device, directory, 0).expect("a run with materials");
    let options = LitOptions {
        size: SIZE,
        layer: LitLayer::Shaded,
        format: TexelFormat::Rgba32Float,
        encoding: Encoding::Linear,
        entry: ImageState::Undefined,
        exit: ImageState::TransferSource,
        frames_in_flight: 2,
        capacity: [0, 0],
    };
    let tuning = Tuning::for_device(device.info());
    let mut view = LitView::new(&device, tuning, run.scene(), run.lighting(), options).expect("a view");
    let camera = scenes::gpu_camera(&scenes::camera(SIZE));
    let mut show = |run: &Relighter| loop {
        let before = view.report().expect("visible").incomplete;
        let frame = LitFrame { camera, background: [0.0; 3], exposure: 1.0 };
        let commands = host.begin();
        let recorded = view.frame(run.scene(), run.lighting(), &target, &frame, |exec, uniforms| {
            // SAFETY: the commands are being recorded here and submitted once.
            unsafe { exec.record_into(commands, uniforms) }
        });
        host.read_image(commands, image.raw, SIZE, back.raw);
        let fence = host.fence();
        host.submit(commands, &[], &[], fence);
        // SAFETY: the fence covers the submission and is waited for before the recording is released.
        unsafe {
            host.device.wait_for_fences(&[fence], true, u64::MAX).expect("done");
            recorded.expect("a slot is free").release();
            host.device.destroy_fence(fence, None);
        }
        // A frame that lacks capacity is shown again; the view raises the capacity for the next frame.
        if view.report().expect("visible").incomplete == before {
            let texels = host.read(&back, bytes);
            let light = bytemuck::pod_collect_to_vec::<u8, [f32; 4]>(&texels);
            break light.into_iter().flat_map(|t| [t[0], t[1], t[2]]).collect::<Vec<f32>>();
        }
    };
    let relit = |run: &Relighter| {
        let scene = run.relit().upload(&device).expect("memory");
        let view = Shading::new(&device, scene).expect("memory").shade_from(&camera).expect("an image");
        view.radiance([0.0; 3]).data
    };
    let (all, all_relit) = (show(&run), relit(&run));
    let mut changed_light = run.light(0).expect("a light");
    changed_light.on = false;
    run.set_light(0, changed_light).expect("a light");
    let (without, without_relit) = (show(&run), relit(&run));
    run.edit(&Edit::parse(r#"{"lights": {"only": [0]}}"#, Path::new("")).expect("an edit")).expect("a light");
    run.set_environment_gain([0.0; 3]).expect("factors");
    let alone = show(&run);
    changed_light.on = true;
    changed_light.position[0] += 0.5;
    run.set_light(0, changed_light).expect("a light");
    let moved = show(&run);
    let largest = all_relit.iter().fold(0.0f32, |m, v| m.max(*v));
    let most = |off: &dyn Fn(usize) -> f32| (0..all.len()).fold(0.0f32, |m, i| m.max(off(i).abs())) / largest;
    let found = [
        most(&|i| all[i] - all_relit[i]).max(most(&|i| without[i] - without_relit[i])),
        most(&|i| all[i] - without[i] - alone[i]),
        most(&|i| moved[i] - alone[i]),
    ];
    drop((view, run, target, device));
    host.destroy_buffer(back);
    host.destroy_image(image);
    found
}

#[allow(dead_code)] // The tests call `run` and `relight`.
fn main() {
    let differ = run(5);
    println!("5 frames, {differ} texels differ");
    assert_eq!(differ, 0);
    if let Some(run) = std::env::args().nth(1) {
        let [relit, sum, moved] = relight(Path::new(&run));
        println!("lit: {relit:.1e} from sgs relight, {sum:.1e} from the sum of its lights; a move changes {moved:.2}");
        assert!(relit < 1e-5 && sum < 1e-5);
    }
}

//! Images in graphs on a real device.
//!
//! Covers kernels, copies between images and buffers, layouts on entry and exit, transients that share an image, and
//! errors.

use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph, Image, ImageState};
use sgs_engine::{DeviceImage, Error, ImageFormat, Location};
use sgs_passes::kernel::stage_with;
use sgs_shaders::{Access, BindingKind, image_probe};
use sgs_tests::Gpu;
use std::sync::Arc;

const SIZE: [u32; 2] = [21, 10];
const TEXELS: usize = 210;
const BYTES: u64 = 16 * TEXELS as u64;

/// Declares a pass of the probe kernel.
fn probe(g: &mut Graph, name: &str, addend: Image, sum: Image, shown: Image, scale: f32) {
    let push = image_probe::Push { size: SIZE, scale };
    let pass = stage_with(g, name, &image_probe::KERNEL, [], bytemuck::bytes_of(&push));
    let pass = pass.bind_image("addend", addend).bind_image("sum", sum).bind_image_discard("displayed", shown);
    pass.dispatch([3, 2, 1]).unwrap();
}

fn executor(gpu: &Gpu, g: Graph) -> Executor {
    let plan = Arc::new(g.compile(&CompileOptions::default()).unwrap());
    Executor::new(gpu.device(), plan, ExecOptions { poison: true, ..Default::default() }).unwrap()
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytemuck::pod_collect_to_vec(bytes)
}

/// Returns whether a byte stores a value: to 0.6 of its last place, as Direct3D requires of devices. Vulkan states no
/// bound.
fn stored(byte: u8, value: f32) -> bool {
    (f32::from(byte) - value.clamp(0.0, 1.0) * 255.0).abs() <= 0.6
}

#[test]
fn reflection_finds_the_access_to_texels() {
    let found: Vec<_> = image_probe::KERNEL.bindings.iter().map(|b| (b.name.as_ref(), b.access, b.kind)).collect();
    let float = BindingKind::Image(ImageFormat::Rgba32Float);
    let bytes = BindingKind::Image(ImageFormat::Rgba8Unorm);
    let expected =
        [("addend", Access::Read, float), ("sum", Access::ReadWrite, float), ("displayed", Access::Write, bytes)];
    assert_eq!(found, expected);
}

/// Adds an uploaded image twice to a transient image.
///
/// The graph uses two transients that can share an image. It leaves an 8-bit image in the state `exit`.
fn build(exit: ImageState) -> (Graph, [Image; 2], sgs_engine::graph::Buffer) {
    let mut g = Graph::new("images");
    let source = g.input("source", BYTES);
    let addend = g.external_image("addend", SIZE, ImageFormat::Rgba32Float, ImageState::Undefined, ImageState::General);
    let shown = g.external_image("shown", SIZE, ImageFormat::Rgba8Unorm, ImageState::Undefined, exit);
    let out = g.external("out", BYTES);
    let first = g.transient_image("first", SIZE, ImageFormat::Rgba32Float);
    let second = g.transient_image("second", SIZE, ImageFormat::Rgba32Float);
    let packed = g.transient("packed", BYTES);
    g.copy_to_image("upload", source, addend).unwrap();
    g.clear_image("clear", first, [0.0, 0.25, 0.5, 1.0]).unwrap();
    probe(&mut g, "once", addend, first, shown, 1.0);
    g.copy_from_image("pack", first, packed).unwrap();
    g.copy_to_image("unpack", packed, second).unwrap();
    probe(&mut g, "twice", addend, second, shown, 0.5);
    g.copy_from_image("download", second, out).unwrap();
    (g, [addend, shown], out)
}

fn bind(gpu: &Gpu, exec: &mut Executor, [addend, shown]: [Image; 2]) -> [DeviceImage; 2] {
    let image = |name, format| gpu.device().image(name, SIZE, format).unwrap();
    let images = [image("addend", ImageFormat::Rgba32Float), image("shown", ImageFormat::Rgba8Unorm)];
    exec.bind_image(addend, &images[0]).unwrap();
    exec.bind_image(shown, &images[1]).unwrap();
    images
}

#[test]
fn kernels_and_copies_on_images() {
    let gpu = Gpu::new();
    let (g, handles, out) = build(ImageState::General);
    let mut exec = executor(&gpu, g);
    assert_eq!(exec.plan().image_slots.len(), 1, "the transients share an image\n{}", exec.plan());
    let images = bind(&gpu, &mut exec, handles);
    let values: Vec<f32> = (0..TEXELS * 4).map(|i| (i % 97) as f32 / 400.0).collect();
    let source = gpu.device().buffer("source", BYTES, Location::Device).unwrap();
    gpu.device().upload(&source, 0, bytemuck::cast_slice(&values)).unwrap();
    let result = gpu.device().buffer("out", BYTES, Location::Device).unwrap();
    exec.bind(exec.plan().buffer(0), &source).unwrap();
    exec.bind(out, &result).unwrap();
    for _ in 0..3 {
        exec.submit(&[]).unwrap();
    }
    exec.finish().unwrap();
    assert_eq!(exec.host_times().recordings, 2, "each slot is recorded once");

    let base = [0.0, 0.25, 0.5, 1.0f32];
    let expected: Vec<f32> = values.iter().enumerate().map(|(i, v)| base[i % 4] + v + v).collect();
    assert_eq!(gpu.device().download_as::<f32>(&result, TEXELS * 4).unwrap(), expected);
    assert_eq!(floats(&gpu.device().download_image(&images[0]).unwrap()), values);
    let shown = gpu.device().download_image(&images[1]).unwrap();
    for (byte, value) in shown.iter().zip(&expected) {
        assert!(stored(*byte, value * 0.5), "{byte} for {value}");
    }
}

#[test]
fn images_are_left_in_the_declared_state() {
    let gpu = Gpu::new();
    let states = [ImageState::TransferSource, ImageState::TransferTarget, ImageState::General];
    for exit in states {
        // A second plan reads the image in the state in which the first leaves it.
        let (g, handles, out) = build(exit);
        let mut exec = executor(&gpu, g);
        let images = bind(&gpu, &mut exec, handles);
        let source = gpu.device().buffer("source", BYTES, Location::Device).unwrap();
        gpu.device().fill(&source, 0.25f32.to_bits()).unwrap();
        exec.bind(exec.plan().buffer(0), &source).unwrap();
        exec.bind(out, &gpu.device().buffer("out", BYTES, Location::Device).unwrap()).unwrap();
        exec.submit(&[]).unwrap();

        let mut g = Graph::new("read");
        let shown = g.external_image("shown", SIZE, ImageFormat::Rgba8Unorm, exit, ImageState::General);
        let bytes = g.external("bytes", BYTES / 4);
        g.copy_from_image("download", shown, bytes).unwrap();
        let mut read = executor(&gpu, g);
        let memory = gpu.device().buffer("bytes", BYTES / 4, Location::Device).unwrap();
        read.bind_image(shown, &images[1]).unwrap();
        read.bind(bytes, &memory).unwrap();
        read.submit(&[]).unwrap();
        read.finish().unwrap();
        exec.finish().unwrap();
        let texel: Vec<u8> = gpu.device().download(&memory, 0, 4).unwrap();
        let values = [0.25, 0.375, 0.5, 0.75];
        assert!(texel.iter().zip(values).all(|(byte, value)| stored(*byte, value)), "{exit:?}: {texel:?}");
        assert_eq!(gpu.device().download_image(&images[1]).unwrap()[..4], texel);
    }
}

#[test]
fn wrong_images_are_refused_by_name() {
    let gpu = Gpu::new();
    let (g, [_, shown], _) = build(ImageState::General);
    let mut exec = executor(&gpu, g);
    let other = gpu.device().image("other", [4, 4], ImageFormat::Rgba8Unorm).unwrap();
    let error = exec.bind_image(shown, &other).unwrap_err().to_string();
    assert!(error.starts_with("Image \"shown\" is declared as 21x10 rgba8unorm, but"), "{error}");
    assert!(matches!(exec.submit(&[]), Err(Error::Unbound { .. })));
}

//! Photometric loss on a device.

use crate::Gpu;
use sgs_engine::graph::Graph;
use sgs_passes::Tuning;
use sgs_passes::loss::{Photometric, loss_sum, photometric, photometric_bwd};
use sgs_passes::reference::photometric::Shape;
use sgs_shaders::structs::{LossStats, Step};

/// First pixel of the view in the buffer of photographs.
pub const OFFSET: usize = 5;
/// Number of pixels in the buffers after the view's pixels.
pub const SPARE: usize = 37;
/// Weights of L1 and of 1 - SSIM.
pub const WEIGHTS: [f32; 2] = [0.8, 0.2];

/// Returns the step parameters of a view of this shape.
pub fn step(shape: Shape) -> Step {
    let mut step = Step { target_offset: OFFSET as u32, ..Default::default() };
    step.camera.size = [shape.width as u32, shape.height as u32];
    [step.weight_l1, step.weight_dssim] = WEIGHTS;
    step
}

/// Pads data with a pattern before and after it, to detect reads out of bounds.
pub fn padded<T: Copy>(before: usize, data: &[T], spare: usize, pattern: T) -> Vec<T> {
    let mut all = vec![pattern; before];
    all.extend_from_slice(data);
    all.resize(all.len() + spare, pattern);
    all
}

/// Returns the bytes of a slice.
pub fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Whether a pixel is invalid, by its column and row and the photograph's size.
pub type Invalid = fn([usize; 2], [usize; 2]) -> bool;

/// Patterns of invalid pixels at ordinary and extreme positions.
pub const INVALID: [(&str, Invalid); 7] = [
    ("single pixels", |[x, y], _| (7 * x + 5 * y) % 29 == 3),
    ("rows", |[_, y], _| y % 6 == 2),
    ("columns on both sides of a tile's border", |[x, _], _| x == 27 || x == 28),
    ("border", |[x, y], [w, h]| x == 0 || y == 0 || x + 1 == w || y + 1 == h),
    ("corners", |[x, y], [w, h]| (x < 3 || x + 3 >= w) && (y < 3 || y + 3 >= h)),
    ("all but one pixel", |at, size| at != size.map(|n| n / 2)),
    ("all", |_, _| true),
];

/// Gives a packed photograph these invalid pixels, and no others. Returns their indices.
pub fn invalidate(photo: &mut [u32], size: [usize; 2], invalid: Invalid) -> Vec<usize> {
    let is_invalid = |p: usize| invalid([p % size[0], p / size[0]], size);
    for (p, word) in photo.iter_mut().enumerate() {
        *word = (*word & 0x00ff_ffff) | if is_invalid(p) { 0 } else { 0xff00_0000 };
    }
    (0..photo.len()).filter(|p| is_invalid(*p)).collect()
}

/// Runs the photometric loss.
///
/// Returns all of `grad_image`, including the spare pixels, and the statistics.
pub fn run_photometric(
    gpu: &Gpu,
    tuning: Tuning,
    shape: Shape,
    largest: [u32; 2],
    image: &[f32],
    targets: &[u32],
) -> (Vec<f32>, LossStats) {
    let mut g = Graph::new("photometric");
    let floats = (shape.pixels() + SPARE) * shape.channels;
    let uniform = g.uniform("step", size_of::<Step>() as u64);
    let image_buffer = g.input("image", 4 * floats as u64);
    let target_buffer = g.input("targets", 4 * (OFFSET + targets.len() + SPARE) as u64);
    let grad_image = g.external("grad_image", 4 * floats as u64);
    let stats = g.external("stats", size_of::<LossStats>() as u64);
    let args = Photometric {
        step: uniform,
        image: image_buffer,
        targets: target_buffer,
        channels: shape.channels as u32,
        largest,
    };
    let partials = photometric(&mut g, tuning, &args).unwrap();
    photometric_bwd(&mut g, tuning, &args, &partials, grad_image).unwrap();
    loss_sum(&mut g, tuning, uniform, (partials.sums, partials.count), None, stats).unwrap();
    let inputs = [
        (uniform, bytes(&[step(shape)])),
        (image_buffer, bytes(&padded(0, image, SPARE * shape.channels, f32::NAN))),
        (target_buffer, bytes(&padded(OFFSET, targets, SPARE, 0x0012_3456))),
    ];
    let out = gpu.run(g, &inputs);
    (out.get(grad_image), out.get::<LossStats>(stats)[0])
}

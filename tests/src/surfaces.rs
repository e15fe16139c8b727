//! Losses of normals and depths on a device.

use crate::Gpu;
use sgs_engine::graph::Graph;
use sgs_passes::Tuning;
use sgs_passes::loss::{GeometryLoss, Photometric, geometry_loss, loss_sum, photometric};
use sgs_passes::reference::geometry_loss::{Scene, Terms};
use sgs_shaders::structs::{LossStats, Step};

/// First pixel of the view in the buffers of all views.
const OFFSET: usize = 3;
/// Number of pixels in the buffers after the view's pixels.
const SPARE: usize = 41;
/// Weights that are exact in 32-bit floats.
pub const WEIGHTS: Terms = Terms { normal: 0.25, normal_smooth: 0.75, depth_smooth: 0.5, depth_variance: 0.875 };

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Results of the device; gradients have the layout of the reference.
pub struct Found {
    /// Gradient of the blended normals.
    pub normals: Vec<f32>,
    /// Gradient of the blended depths and their squares.
    pub depths: Vec<f32>,
    /// Gradient of the transmittances.
    pub transmittance: Vec<f32>,
    /// Loss statistics.
    pub stats: LossStats,
}

/// Rounds to single precision, so that device and reference use equal numbers.
pub fn narrow(x: f64) -> f64 {
    f64::from(x as f32)
}

/// Runs the losses of a view with these weights.
pub fn run(gpu: &Gpu, tuning: Tuning, s: &Scene, largest: [u32; 2], weights: &Terms) -> Found {
    let pixels = s.width * s.height;
    let normal_at = s.normals.as_ref().map(|_| 3_usize);
    let depth_at = s.depths.as_ref().map(|_| 3 + 3 * s.normals.iter().len());
    let channels = depth_at.map_or(6, |d| d + 2);
    let mut image = vec![f32::NAN; (pixels + SPARE) * channels];
    for p in 0..pixels {
        let at = p * channels;
        image[at..at + 3].fill(0.5);
        if let (Some(n), Some(k)) = (&s.normals, normal_at) {
            image[at + k..at + k + 3].copy_from_slice(&n[p].map(|x| x as f32));
        }
        if let (Some(d), Some(k)) = (&s.depths, depth_at) {
            image[at + k..at + k + 2].copy_from_slice(&d[p].map(|x| x as f32));
        }
    }
    let padded = |data: Vec<u32>| [vec![0x7777_7777; OFFSET], data, vec![0x7777_7777; SPARE]].concat();
    let mut transmittance: Vec<f32> = s.transmittance.iter().map(|&t| t as f32).collect();
    transmittance.resize(pixels + SPARE, f32::NAN);

    let mut g = Graph::new("geometry_loss");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let image_buffer = g.input("image", 4 * image.len() as u64);
    let transmittance_buffer = g.input("transmittance", 4 * transmittance.len() as u64);
    let words = 4 * (OFFSET + pixels + SPARE) as u64;
    let (targets, priors) = (g.input("targets", words), g.input("priors", words));
    let grad_image = g.external("grad_image", 4 * image.len() as u64);
    let grad_transmittance = g.external("grad_transmittance", 4 * transmittance.len() as u64);
    let stats = g.external("stats", size_of::<LossStats>() as u64);
    let a = GeometryLoss {
        step,
        image: image_buffer,
        channels: channels as u32,
        normals: normal_at.map(|k| k as u32),
        depth: depth_at.map(|k| k as u32),
        transmittance: transmittance_buffer,
        targets,
        priors: s.priors.as_ref().map(|_| priors),
        largest,
    };
    let geometry = geometry_loss(&mut g, tuning, &a, grad_image, grad_transmittance).unwrap();
    // The photometric pass only fills its sums, so that the statistics are complete.
    let color = Photometric { step, image: image_buffer, targets, channels: channels as u32, largest };
    let partials = photometric(&mut g, tuning, &color).unwrap();
    let (photometric, geometry) = ((partials.sums, partials.count), (geometry.sums, geometry.count));
    loss_sum(&mut g, tuning, step, photometric, Some(geometry), stats).unwrap();

    let mut values = Step { target_offset: OFFSET as u32, ..Default::default() };
    values.camera.size = [s.width as u32, s.height as u32];
    values.weight_normal = weights.normal as f32;
    values.weight_normal_smooth = weights.normal_smooth as f32;
    values.weight_depth_smooth = weights.depth_smooth as f32;
    values.weight_depth_variance = weights.depth_variance as f32;
    let inputs = [
        (step, bytes(&[values])),
        (image_buffer, bytes(&image)),
        (transmittance_buffer, bytes(&transmittance)),
        (targets, bytes(&padded(s.photo.clone()))),
        (priors, bytes(&padded(s.priors.clone().unwrap_or(vec![0; pixels])))),
    ];
    let out = gpu.run(g, &inputs);
    let (by_image, by_transmittance) = (out.get::<f32>(grad_image), out.get::<f32>(grad_transmittance));
    let mut found = Found {
        normals: vec![],
        depths: vec![],
        transmittance: by_transmittance[..pixels].to_vec(),
        stats: out.get::<LossStats>(stats)[0],
    };
    for (p, pixel) in by_image.chunks(channels).enumerate() {
        let written = if p < pixels { 3..channels.min(depth_at.map_or(6, |d| d + 2)) } else { 0..0 };
        for (c, x) in pixel.iter().enumerate() {
            assert!(written.contains(&c) || x.to_bits() == u32::MAX, "channel {c} of pixel {p} was written");
        }
        if p < pixels {
            found.normals.extend(normal_at.iter().flat_map(|&k| &pixel[k..k + 3]));
            found.depths.extend(depth_at.iter().flat_map(|&k| &pixel[k..k + 2]));
        }
    }
    assert!(by_transmittance[pixels..].iter().all(|x| x.to_bits() == u32::MAX));
    found
}

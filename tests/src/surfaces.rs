//! Losses of normals and depths on a device.

use crate::Gpu;
use sgs_engine::graph::Graph;
use sgs_passes::Tuning;
use sgs_passes::loss::{DepthFit, GeometryLoss, Photometric, depth_fit, geometry_loss, loss_sum, photometric};
use sgs_passes::reference::geometry_loss::{Lens, Scene, Terms};
use sgs_shaders::structs::{LossStats, Step};

/// First pixel of the view in the buffers of all views.
const OFFSET: usize = 3;
/// Number of pixels in the buffers after the view's pixels.
const SPARE: usize = 41;
/// Weights that are exact in 32-bit floats.
pub const WEIGHTS: Terms =
    Terms { normal: 0.25, normal_smooth: 0.75, depth_smooth: 0.5, depth_variance: 0.875, depth: 0.625 };

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
    let [step, lens] = ["step", "lens"].map(|name| g.uniform(name, size_of::<Step>() as u64));
    let image_buffer = g.input("image", 4 * image.len() as u64);
    let transmittance_buffer = g.input("transmittance", 4 * transmittance.len() as u64);
    let words = 4 * (OFFSET + pixels + SPARE) as u64;
    let [targets, priors, depth_priors] = ["targets", "priors", "depth_priors"].map(|name| g.input(name, words));
    let depth_line = g.input("depth_line", 8);
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
        depth_priors: s.depth_priors.as_ref().map(|_| depth_priors),
        depth_line: s.depth_line.map(|_| depth_line),
        depth_lens: s.depth_lens.map(|_| lens),
        largest,
    };
    let tuning = Tuning { distorted: s.depth_lens.is_some(), ..tuning };
    let geometry = geometry_loss(&mut g, tuning, &a, grad_image, grad_transmittance).unwrap();
    // The photometric pass only fills its sums, so that the statistics are complete.
    let color = Photometric { step, image: image_buffer, targets, channels: channels as u32, largest };
    let partials = photometric(&mut g, tuning, &color).unwrap();
    loss_sum(&mut g, tuning, step, (partials.sums, partials.count), Some(geometry), stats).unwrap();

    let mut values = Step { target_offset: OFFSET as u32, ..Default::default() };
    values.camera.size = [s.width as u32, s.height as u32];
    values.weight_normal = weights.normal as f32;
    values.weight_normal_smooth = weights.normal_smooth as f32;
    values.weight_depth_smooth = weights.depth_smooth as f32;
    values.weight_depth_variance = weights.depth_variance as f32;
    values.weight_depth = weights.depth as f32;
    let seen_by = |lens: Lens| {
        let mut seen = values;
        seen.camera.focal = lens.focal.as_vec2().to_array();
        seen.camera.center = lens.center.as_vec2().to_array();
        seen.camera.radial = lens.radial as f32;
        seen
    };
    let [view, sensor] = s.depth_lens.map_or([values; 2], |lenses| lenses.map(seen_by));
    let inputs = [
        (step, bytes(&[view])),
        (lens, bytes(&[sensor])),
        (image_buffer, bytes(&image)),
        (transmittance_buffer, bytes(&transmittance)),
        (targets, bytes(&padded(s.photo.clone()))),
        (priors, bytes(&padded(s.priors.clone().unwrap_or(vec![0; pixels])))),
        (depth_line, bytes(&s.depth_line.unwrap_or_default().map(|x| x as f32))),
        (depth_priors, bytes(&padded(s.depth_priors.clone().unwrap_or(vec![0; pixels])))),
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

/// Runs the fit of a view's prior depths. Returns slope and offset.
pub fn fit(gpu: &Gpu, s: &Scene, shift: bool) -> [f32; 2] {
    let pixels = s.width * s.height;
    let channels = 8;
    let mut image = vec![f32::NAN; (pixels + SPARE) * channels];
    for (p, depth) in s.depths.iter().flatten().enumerate() {
        image[p * channels + 6] = depth[0] as f32;
    }
    let transmittance: Vec<f32> = s.transmittance.iter().map(|&t| t as f32).collect();
    let none = vec![0x7777_7777; OFFSET];
    let priors = [none.clone(), s.depth_priors.clone().unwrap_or_default(), none].concat();
    let mut g = Graph::new("depth_fit");
    let a = DepthFit {
        step: g.uniform("step", size_of::<Step>() as u64),
        image: g.input("image", 4 * image.len() as u64),
        channels: channels as u32,
        depth: 6,
        transmittance: g.input("transmittance", 4 * pixels as u64),
        priors: g.input("priors", 4 * priors.len() as u64),
        shift,
    };
    let line = depth_fit(&mut g, gpu.tuning(), &a).unwrap();
    let found = g.external("found", 8);
    g.copy("copy", line, found).unwrap();
    let mut values = Step { target_offset: OFFSET as u32, ..Default::default() };
    values.camera.size = [s.width as u32, s.height as u32];
    let inputs = [
        (a.step, bytes(&[values])),
        (a.image, bytes(&image)),
        (a.transmittance, bytes(&transmittance)),
        (a.priors, bytes(&priors)),
    ];
    let out = gpu.run(g, &inputs).get::<f32>(found);
    [out[0], out[1]]
}

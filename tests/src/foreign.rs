//! Splats and lights for tests of exchange with other programs.
//!
//! Every number of the splats is different, so that a swapped field shows.

use sgs_run::{LightFile, LightRow, LobeRow};
use sgs_scene::Splats;

/// Returns splats in front of a camera of the room; every number is different.
pub fn sample(n: usize) -> Splats {
    let mut state = 11_u32;
    let mut next = |low: f32, high: f32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        low + (high - low) * ((state >> 8) as f32 / (1 << 24) as f32)
    };
    let mut many = |k: usize, low, high| (0..k).map(|_| next(low, high)).collect::<Vec<f32>>();
    let three = |v: Vec<f32>| v.as_chunks::<3>().0.to_vec();
    Splats {
        means: three(many(n * 3, -1.0, 1.0)),
        log_scales: three(many(n * 3, -3.0, -0.1)),
        rotations: many(n * 4, -2.0, 2.0).as_chunks::<4>().0.to_vec(),
        opacity_logits: many(n, -20.0, 20.0),
        sh: [many(n * 3, -1.5, 1.5), many(n * 9, -0.2, 0.2), many(n * 15, -0.1, 0.1), many(n * 21, -0.1, 0.1)],
        normals: Some(three(many(n * 3, -1.0, 1.0))),
        albedo: Some(three(many(n * 3, -5.0, 5.0))),
        roughness: Some(many(n, -9.0, 9.0)),
        metallic: Some(many(n, -9.0, 9.0)),
        semantic: Some((3, many(n * 3, -1.0, 1.0))),
        emitters: None,
        light_gains: None,
        antialiased: false,
    }
}

/// Returns three lights of twelve lobes.
pub fn lights() -> LightFile {
    let lobe = |k: usize| LobeRow {
        axis: [0.6, 0.0, 0.8],
        sharpness: 0.3 * k as f32,
        amplitude: [0.1 + k as f32, 0.7, 1.0 / 3.0],
    };
    let light = |i: usize| LightRow {
        position: [0.1 * i as f32, -0.3, 1.7],
        gain: 0.5 + i as f32,
        lobes: (0..12).map(lobe).collect(),
    };
    LightFile::new(1.0 / 81.0, (0..3).map(light).collect())
}

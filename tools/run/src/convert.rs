//! Conversion between scenes on disk and on the GPU: cameras, splats, packed pixels.

use sgs_passes::loss::{octahedral_encode, pack_depth, pack_relative_depth};
use sgs_passes::pipeline::Camera;
use sgs_passes::scene::{GaussianData, Group, Model};
use sgs_scene::DepthMeaning;
use sgs_scene::Splats;

/// Converts a camera to the layout of the kernels. Each use fills in `tiles`.
pub fn camera(c: &sgs_scene::Camera) -> Camera {
    let row = |i: usize| {
        let r = c.rotation.row(i);
        [r.x as f32, r.y as f32, r.z as f32, c.translation[i] as f32]
    };
    Camera {
        world_to_camera: [row(0), row(1), row(2)],
        position: c.position().as_vec3().to_array(),
        near: c.near as f32,
        radial: 0.0,
        focal: [c.fx as f32, c.fy as f32],
        center: [c.cx as f32, c.cy as f32],
        size: [c.width, c.height],
        tiles: [0, 0],
    }
}

/// Converts splats to the GPU layout of a model. Missing normals and bands become zeros.
pub fn gaussian_data(s: &Splats, model: Model) -> GaussianData {
    let mut d = GaussianData::default();
    for group in model.groups() {
        let width = group.width() as usize;
        let flat = match group {
            Group::Means => s.means.as_flattened().to_vec(),
            Group::LogScales => s.log_scales.as_flattened().to_vec(),
            Group::Rotations => s.rotations.as_flattened().to_vec(),
            Group::OpacityLogits => s.opacity_logits.clone(),
            Group::Sh0 => s.sh[0].clone(),
            Group::Sh1 => s.sh[1].clone(),
            Group::Sh2 => s.sh[2].clone(),
            Group::Sh3 => s.sh[3].clone(),
            Group::Normals => s.normals.as_ref().map_or_else(Vec::new, |n| n.as_flattened().to_vec()),
            Group::Semantics => match &s.semantic {
                Some((channels, values)) if *channels == width => values.clone(),
                _ => Vec::new(),
            },
        };
        d.groups[group as usize] = if flat.is_empty() { vec![0.0; width * s.len()] } else { flat };
    }
    d
}

/// Converts the GPU layout back to splats.
pub fn splats(d: &GaussianData, model: Model) -> Splats {
    let triples = |g: Group| d.group(g).as_chunks::<3>().0.to_vec();
    let mut s = Splats {
        means: triples(Group::Means),
        log_scales: triples(Group::LogScales),
        rotations: d.group(Group::Rotations).as_chunks::<4>().0.to_vec(),
        opacity_logits: d.group(Group::OpacityLogits).to_vec(),
        normals: model.normals.then(|| triples(Group::Normals)),
        antialiased: model.mip,
        semantic: model.semantics.then(|| (Group::Semantics.width() as usize, d.group(Group::Semantics).to_vec())),
        ..Default::default()
    };
    for band in 0..=model.sh_degree as usize {
        s.sh[band] = d.groups[Group::Sh0 as usize + band].clone();
    }
    s
}

/// Packs a photograph to RGBA8 with red in the low byte. Alpha is 0 where the mask excludes a pixel, else 255.
pub fn pack_image(image: &sgs_scene::Image, mask: Option<&sgs_scene::Image>) -> Vec<u32> {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u32;
    let valid = |i: usize| mask.is_none_or(|m| m.data[i] > 0.5);
    let color = |p: &[f32]| byte(p[0]) | byte(p[1]) << 8 | byte(p[2]) << 16 | 0xff00_0000;
    // Windows of SSIM reach beyond valid pixels, so the color of invalid ones is dropped, too.
    let pack = |(i, p): (usize, &[f32])| if valid(i) { color(p) } else { 0 };
    image.data.chunks_exact(image.channels as usize).enumerate().map(pack).collect()
}

/// Packs world-space normals to octahedral 2 × 16 bits; 0 marks a missing normal.
pub fn pack_normals(image: &sgs_scene::Image) -> Vec<u32> {
    image.data.chunks_exact(3).map(|n| octahedral_encode([n[0], n[1], n[2]])).collect()
}

/// Packs a map of prior depths and their confidence.
///
/// For [`sgs_passes::loss::GeometryLoss`].
pub fn pack_depths(map: &sgs_scene::MaskedMap, meaning: DepthMeaning) -> Vec<u32> {
    let (values, confidence) = (&map.image.data, &map.valid.data);
    match meaning {
        DepthMeaning::Metric => values.iter().zip(confidence).map(|(&z, &c)| pack_depth(z, c)).collect(),
        DepthMeaning::Scale => {
            let inverse: Vec<f32> = values.iter().map(|z| 1.0 / z).collect();
            pack_relative_depth(&inverse, confidence, false)
        }
        DepthMeaning::InverseScaleShift => pack_relative_depth(values, confidence, true),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_scene::Image;

    #[test]
    fn mask_sets_alpha() {
        let image = Image::from_data(2, 1, 3, vec![0.0, 0.5, 1.0, 1.0, 2.0, -1.0]).unwrap();
        assert_eq!(pack_image(&image, None), [0xffff_8000, 0xff00_ffff]);
        let mask = Image::from_data(2, 1, 1, vec![0.0, 1.0]).unwrap();
        assert_eq!(pack_image(&image, Some(&mask)), [0, 0xff00_ffff]);
    }
}

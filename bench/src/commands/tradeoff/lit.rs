//! Double-precision reference of a shaded image, from splats to display values.
//!
//! Runs the references of all passes of a step in sequence.

use crate::workload::{reference_camera, reference_gaussians};
use anyhow::{Context, bail};
use rayon::prelude::*;
use sgs_passes::pipeline::Camera;
use sgs_passes::reference::brdf::Material;
use sgs_passes::reference::environment::{Cube, Pixel as Seen, prefilter, shade};
use sgs_passes::reference::gbuffer::{Materials, gbuffer, weights};
use sgs_passes::reference::lights::{Light, Lobe, Pixel, shine};
use sgs_passes::reference::visibility::Field;
use sgs_passes::reference::{blend, compose, project};
use sgs_passes::scene::Model;
use sgs_passes::shade::ALBEDO_RANGE;
use sgs_passes::shade::environment::{Environment, EnvironmentOptions};
use sgs_run::{RunLight, Visibility, gaussian_data};
use sgs_scene::Splats;

type V3 = [f64; 3];

/// Returns display values, three per pixel.
pub fn shaded_reference(
    splats: &Splats,
    light: &RunLight,
    camera: &Camera,
    background: [f32; 3],
) -> anyhow::Result<Vec<f64>> {
    let model = Model { sh_degree: 0, normals: true, semantics: false, mip: false };
    let gaussians = reference_gaussians(&gaussian_data(splats, model));
    let (view, background) = (reference_camera(camera), background.map(f64::from));
    let projected = project::project(&gaussians, &view, 0, true);
    let blended = blend::blend(&projected, view.size, 8, [0.0; 3]);
    let surfaces = gbuffer(&view, &blended, 8);
    let wide = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let materials = Materials {
        albedo: wide(splats.albedo.as_ref().context("There is no albedo.")?.as_flattened()),
        roughness: wide(splats.roughness.as_ref().context("There is no roughness.")?),
        metallic: splats.metallic.as_ref().map_or_else(Vec::new, |m| wide(m)),
        albedo_range: ALBEDO_RANGE.map(f64::from),
    };
    let of_pixels = materials.blend(&weights(&projected, view.size));

    let lights: Vec<Light> =
        light.lights.iter().flat_map(|l| &l.lights).filter(|l| l.gain != 0.0).map(double_precision).collect();
    let normalizer = light.lights.as_ref().map_or(0.0, |l| f64::from(l.normalizer));
    let field = match &light.visibility {
        Visibility::None => None,
        Visibility::Learned(v) => Some(Field::new(&v.config, &v.tables, &v.mlp, v.low, v.high)),
        Visibility::Traced(_) => bail!("Traced shadows are not worked out in double precision here."),
    };
    let around = match &light.environment {
        Some(t) => {
            let options = EnvironmentOptions { smoothness: None, ..Default::default() };
            let e = Environment::new(t.size, &options)?;
            let cube = Cube::from_floats(t.size as usize, &t.data);
            let levels: Vec<Cube> = e.levels().par_iter().map(|l| prefilter(&cube, l)).collect();
            Some((e, levels))
        }
        None => None,
    };
    let eye = camera.position.map(f64::from);
    let radiance = |p: usize| -> V3 {
        let [r, g, b, roughness, metallic] = of_pixels[p];
        let (albedo, coverage) = ([r, g, b], surfaces.coverage[p]);
        let (point, normal) = (surfaces.points[p].to_array(), surfaces.normals[p].to_array());
        let pixel = Pixel { point, normal, coverage, material: Material { albedo, roughness, metallic } };
        let mut sum = [0.0; 3];
        for light in &lights {
            let [diffuse, specular] = shine(&pixel, light, eye);
            if diffuse == [0.0; 3] && specular == [0.0; 3] {
                continue;
            }
            let seen = field.as_ref().map_or(1.0, |f| f.visibility(point, light.place));
            (0..3).for_each(|c| sum[c] += normalizer * seen * (diffuse[c] + specular[c]));
        }
        if let Some((e, levels)) = &around {
            let seen = Seen { point, normal, coverage, albedo, roughness, metallic };
            let ambient = shade(levels, e.split_sum(), eye, &seen);
            (0..3).for_each(|c| sum[c] += ambient[c]);
        }
        sum
    };
    let radiance: Vec<V3> = (0..of_pixels.len()).into_par_iter().map(radiance).collect();
    Ok(compose::compose(&radiance, &surfaces.coverage, background).0)
}

fn double_precision(l: &sgs_run::LightRow) -> Light {
    let lobe = |k: &sgs_run::LobeRow| Lobe {
        axis: k.axis.map(f64::from),
        sharpness: f64::from(k.sharpness),
        amplitude: k.amplitude.map(|a| f64::from(a) * f64::from(l.gain)),
    };
    Light { place: l.position.map(f64::from), lobes: l.lobes.iter().map(lobe).collect() }
}

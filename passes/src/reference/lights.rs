//! Reference of the kernels of `lights`. Radiance under spherical-Gaussian lights, and its gradients as central
//! differences.
//!
//! Radiance is linear in the lights. Differences by a light's parameters are therefore taken of that light alone, so
//! that the radiance of the others does not add rounding errors.

use super::brdf::{Material, V3, along, brdf, dot, unit};
use crate::rng::{random_bits, uniform_from};
use crate::shade::lights::{Axes, LightModel, Perturbation};
use std::f64::consts::PI;

/// One activated lobe.
#[derive(Clone, Copy, Debug)]
pub struct Lobe {
    /// Unit axis.
    pub axis: V3,
    /// Sharpness lambda.
    pub sharpness: f64,
    /// Amplitude mu, including the light's gain.
    pub amplitude: V3,
}

/// One activated light.
#[derive(Clone, Debug)]
pub struct Light {
    /// Position.
    pub place: V3,
    /// Lobes.
    pub lobes: Vec<Lobe>,
}

/// Surface of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Position.
    pub point: V3,
    /// Unit normal or zero.
    pub normal: V3,
    /// Blended opacity.
    pub coverage: f64,
    /// Material of the surface.
    pub material: Material,
}

/// Raw parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Raw {
    /// Sizes.
    pub model: LightModel,
    /// Positions, `[lights * 3]`.
    pub positions: Vec<f64>,
    /// Lobes, `[lights * lobes * row]`.
    pub lobes: Vec<f64>,
    /// Gains, `[lights]`.
    pub gains: Vec<f64>,
}

/// Returns the axis of a lobe's row.
pub fn axis(model: LightModel, lobe: u32, row: &[f64]) -> V3 {
    if model.axes == Axes::Free {
        let raw = [row[0], row[1], row[2]];
        return if dot(raw, raw).sqrt() > 1e-6 { unit(raw) } else { [0.0, 0.0, 1.0] };
    }
    let rows = if model.lobes.is_multiple_of(2) { 2 } else { 1 };
    let columns = model.lobes / rows;
    let polar = (f64::from(lobe / columns) + 0.5) * PI / (2.0 * f64::from(rows));
    let azimuth = ((f64::from(lobe % columns) + 0.5) / f64::from(columns) - 0.5) * 2.0 * PI;
    let (theta, phi) = (polar + 3.0 * PI / 8.0 * row[0].tanh(), azimuth + PI / 2.0 * row[1].tanh());
    [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
}

/// Activates the raw parameters of a light; returns `None` if the light is off.
pub fn prepare_one(raw: &Raw, light: usize) -> Option<Light> {
    if raw.gains[light] == 0.0 {
        return None;
    }
    let width = raw.model.row() as usize;
    let count = raw.model.lobes as usize;
    let at = 3 * light;
    let lobes = (0..count).map(|k| {
        let row = &raw.lobes[(light * count + k) * width..][..width];
        let [sharpness, amplitude @ ..] = &row[width - 4..] else { unreachable!() };
        Lobe {
            axis: axis(raw.model, k as u32, row),
            sharpness: sharpness.min(9.5).exp(),
            amplitude: [0, 1, 2].map(|c| raw.gains[light] * amplitude[c].min(15.0).exp()),
        }
    });
    Some(Light { place: [raw.positions[at], raw.positions[at + 1], raw.positions[at + 2]], lobes: lobes.collect() })
}

/// Activates the raw parameters of all lights.
pub fn lights_prepare(raw: &Raw) -> Vec<Option<Light>> {
    (0..raw.model.lights as usize).map(|i| prepare_one(raw, i)).collect()
}

/// Returns the parameters of a copy with perturbed positions and gains. See [`Perturbation`].
pub fn perturb(raw: &Raw, seed: u32, p: &Perturbation) -> Raw {
    let random = |light: usize, which: u32| {
        2.0 * uniform_from(random_bits(seed ^ 0x5a17, p.copy, 8 * light as u32 + which)) - 1.0
    };
    let mut copy = raw.clone();
    for light in 0..raw.gains.len() {
        copy.gains[light] *= 1.0 + f64::from(p.intensity) * random(light, 0);
        if 0.5 * (random(light, 1) + 1.0) < f64::from(p.off) {
            copy.gains[light] = 0.0;
        }
        for axis in 0..3 {
            copy.positions[3 * light + axis] += f64::from(p.distance) * random(light, 2 + axis as u32);
        }
    }
    copy
}

/// Returns the light that a pixel's surface reflects to the camera. The two components are diffuse and specular.
pub fn shine(pixel: &Pixel, light: &Light, camera: V3) -> [V3; 2] {
    let dark = [[0.0; 3]; 2];
    let to_light = along(light.place, -1.0, pixel.point);
    let l = unit(to_light);
    let nl = dot(pixel.normal, l);
    if pixel.coverage < f64::from(1e-3_f32) || nl <= 0.0 {
        return dark;
    }
    let mut emitted = [0.0; 3];
    for lobe in &light.lobes {
        let apart = along(l, -1.0, lobe.axis);
        let s = (-0.5 * lobe.sharpness * dot(apart, apart)).exp();
        emitted = along(emitted, s, lobe.amplitude);
    }
    let falloff = 1.0 / dot(to_light, to_light).max(1e-3);
    let v = unit(along(camera, -1.0, pixel.point));
    brdf(pixel.material, pixel.normal, l, v).map(|f| [0, 1, 2].map(|c| f[c] * emitted[c] * nl * falloff))
}

/// Returns the diffuse and the specular radiance of pixels, as RGB of each pixel.
pub fn lights(pixels: &[Pixel], lights: &[Option<Light>], camera: V3, normalizer: f64) -> [Vec<f64>; 2] {
    let mut parts = [Vec::new(), Vec::new()];
    for pixel in pixels {
        let mut sums = [[0.0; 3]; 2];
        for light in lights.iter().flatten() {
            let s = shine(pixel, light, camera);
            sums = [0, 1].map(|i| along(sums[i], normalizer, s[i]));
        }
        (0..2).for_each(|i| parts[i].extend(sums[i]));
    }
    parts
}

/// Returns a pixel's radiance dotted with its gradient.
fn loss(pixel: &Pixel, light: &Light, camera: V3, gradient: &[f64]) -> f64 {
    let [d, s] = shine(pixel, light, camera);
    dot([gradient[0], gradient[1], gradient[2]], along(d, 1.0, s))
}

/// Returns the derivative of `f` at `x` by central differences.
fn slope(x: f64, step: f64, mut f: impl FnMut(f64) -> f64) -> f64 {
    // Uses the rounded arguments: for large x, a small step is rounded considerably.
    let (up, down) = (x + step, x - step);
    (f(up) - f(down)) / (up - down)
}

/// Returns component `i` of a material: albedo (3), roughness, metallic.
fn number(m: &mut Material, i: usize) -> &mut f64 {
    match i {
        3 => &mut m.roughness,
        4 => &mut m.metallic,
        c => &mut m.albedo[c],
    }
}

/// Returns the gradients of each pixel's albedo (3), roughness and metallic.
pub fn lights_materials_bwd(
    pixels: &[Pixel],
    lights: &[Option<Light>],
    camera: V3,
    normalizer: f64,
    gradient: &[f64],
) -> Vec<[f64; 5]> {
    let one = |(pixel, g): (&Pixel, &[f64])| {
        [0, 1, 2, 3, 4].map(|i| {
            let mut p = *pixel;
            let x = *number(&mut p.material, i);
            let step = if i == 3 { 1e-6 * x } else { 1e-6 };
            let by_light = |light| {
                slope(x, step, |x| {
                    *number(&mut p.material, i) = x;
                    loss(&p, light, camera, g)
                })
            };
            normalizer * lights.iter().flatten().map(by_light).sum::<f64>()
        })
    };
    pixels.iter().zip(gradient.chunks(3)).map(one).collect()
}

/// Returns the gradients of each pixel's unit normal, orthogonal to the normal.
pub fn lights_normals_bwd(
    pixels: &[Pixel],
    lights: &[Option<Light>],
    camera: V3,
    normalizer: f64,
    gradient: &[f64],
) -> Vec<V3> {
    let one = |(pixel, g): (&Pixel, &[f64])| {
        let free = [0, 1, 2].map(|i| {
            let mut p = *pixel;
            let x = p.normal[i];
            let by_light = |light| {
                slope(x, 1e-7, |x| {
                    p.normal[i] = x;
                    loss(&p, light, camera, g)
                })
            };
            normalizer * lights.iter().flatten().map(by_light).sum::<f64>()
        });
        along(free, -dot(pixel.normal, free), pixel.normal)
    };
    pixels.iter().zip(gradient.chunks(3)).map(one).collect()
}

/// Gradients of raw parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct RawGradients {
    /// Gradients of positions, `[lights * 3]`.
    pub positions: Vec<f64>,
    /// Gradients of lobes, `[lights * lobes * row]`.
    pub lobes: Vec<f64>,
}

/// Returns the gradients of the lights' raw parameters. Zero for lights that are off. The position's gradient ignores
/// pixels at exactly the light's position, where no gradient exists.
pub fn lights_bwd(raw: &Raw, pixels: &[Pixel], camera: V3, normalizer: f64, gradient: &[f64]) -> RawGradients {
    let mut raw = raw.clone();
    let mut found = RawGradients { positions: vec![0.0; raw.positions.len()], lobes: vec![0.0; raw.lobes.len()] };
    let shown: Vec<(&Pixel, &[f64])> =
        pixels.iter().zip(gradient.chunks(3)).filter(|(p, _)| p.coverage >= f64::from(1e-3_f32)).collect();
    let all = |raw: &Raw, light: usize, shown: &[(&Pixel, &[f64])]| {
        let Some(light) = prepare_one(raw, light) else { return 0.0 };
        normalizer * shown.iter().map(|(p, g)| loss(p, &light, camera, g)).sum::<f64>()
    };
    for light in 0..raw.model.lights as usize {
        let place = [0, 1, 2].map(|i| raw.positions[3 * light + i]);
        let apart = |p: &Pixel| {
            let d = along(place, -1.0, p.point);
            dot(d, d).sqrt()
        };
        let others: Vec<_> = shown.iter().copied().filter(|(p, _)| apart(p) > 0.0).collect();
        let nearest = others.iter().map(|(p, _)| apart(p)).fold(1.0, f64::min);
        for i in 3 * light..3 * light + 3 {
            let x = raw.positions[i];
            found.positions[i] = slope(x, 1e-6 * nearest, |x| {
                raw.positions[i] = x;
                all(&raw, light, &others)
            });
            raw.positions[i] = x;
        }
        let row = (raw.model.lobes * raw.model.row()) as usize;
        for i in row * light..row * (light + 1) {
            let x = raw.lobes[i];
            // A small step turns a short axis far.
            let (width, free) = (raw.model.row() as usize, raw.model.axes == Axes::Free);
            let axis = &raw.lobes[i / width * width..][..3];
            let length = dot([axis[0], axis[1], axis[2]], [axis[0], axis[1], axis[2]]).sqrt();
            let step = if free && i % width < 3 { 1e-6 * length.clamp(1e-6, 1.0) } else { 1e-6 };
            found.lobes[i] = slope(x, step, |x| {
                raw.lobes[i] = x;
                all(&raw, light, &shown)
            });
            raw.lobes[i] = x;
        }
    }
    found
}

/// Returns the nearest pixel with a surface for each light, if any. Each entry holds the squared distance and the
/// pixel's index. Lights that are off have none.
pub fn lights_near(raw: &Raw, pixels: &[Pixel]) -> Vec<Option<(f64, usize)>> {
    let place = |light: usize| [0, 1, 2].map(|i| raw.positions[3 * light + i]);
    let near = |light: usize| {
        let shown = pixels.iter().enumerate().filter(|(_, p)| p.coverage >= f64::from(1e-3_f32));
        let squares = shown.map(|(i, p)| {
            let d = along(place(light), -1.0, p.point);
            (dot(d, d), i)
        });
        squares.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    (0..raw.gains.len()).map(|light| near(light).filter(|_| raw.gains[light] != 0.0)).collect()
}

/// Returns the regularizers. They are the mean of `1 / max(d², 1e-3)`, and three times the mean of the amplitudes.
pub fn lights_regularize(raw: &Raw, pixels: &[Pixel]) -> [f64; 2] {
    let near = lights_near(raw, pixels).iter().flatten().map(|(square, _)| 1.0 / square.max(1e-3)).sum::<f64>();
    let (width, lobes) = (raw.model.row() as usize, raw.model.lobes as usize);
    let rows = raw.lobes.chunks(width).enumerate().filter(|(i, _)| raw.gains[i / lobes] != 0.0);
    let bright = rows.flat_map(|(_, row)| &row[width - 3..]).map(|x| x.min(15.0).exp()).sum::<f64>();
    [near / f64::from(raw.model.lights), bright / f64::from(raw.model.lights * raw.model.lobes)]
}

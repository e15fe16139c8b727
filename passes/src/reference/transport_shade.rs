//! Reference of `transport_shade`: radiance under physical lights and gathered irradiance.

use super::area_lights::{Kind, Light};
use super::brdf::{ALPHA_MIN, V3, along, brdf, dot, unit};
use super::environment::split_sum;
use super::lights::Pixel;
use std::f64::consts::PI;

/// Largest number that the extent of a light adds to alpha.
const SPREAD_MAX: f64 = 0.5;
/// Smallest |l + v|² of highlights.
const HALF_MIN: f64 = 1e-6;
/// Smallest n.v of mirrored rays.
const MIRRORED_MIN: f64 = 0.01;

/// Terms of the radiance of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Diffuse reflection of the lights.
    pub diffuse: V3,
    /// Specular reflection of the lights.
    pub specular: V3,
    /// Reflection of the gathered irradiance.
    pub indirect: V3,
    /// Emission.
    pub emission: V3,
}

impl Terms {
    /// Returns the sum of the terms.
    pub fn radiance(&self) -> V3 {
        std::array::from_fn(|k| self.diffuse[k] + self.specular[k] + self.indirect[k] + self.emission[k])
    }
}

/// Inputs of a pixel besides its surface.
#[derive(Clone, Debug)]
pub struct Incoming {
    /// Irradiance of color 1, by light.
    pub unit: Vec<f64>,
    /// Gathered irradiance.
    pub irradiance: V3,
    /// Factor on all light that arrives.
    pub gain: f64,
    /// Emitted radiance.
    pub emission: V3,
}

/// Camera, lights and table of a view.
#[derive(Clone, Copy, Debug)]
pub struct View<'v> {
    /// Position of the camera.
    pub camera: V3,
    /// Lights.
    pub lights: &'v [Light],
    /// Colors of the lights.
    pub colors: &'v [V3],
    /// Split-sum table.
    pub split_sum: &'v [[f32; 2]],
}

/// Returns the direction that stands for a light. Also what its extent adds to alpha along two axes.
pub fn representative(light: &Light, point: V3, mirrored: V3) -> (V3, [f64; 2]) {
    let to = along(light.origin, -1.0, point);
    let distance = dot(to, to).sqrt();
    match light.kind {
        Kind::Point | Kind::Spot | Kind::Lobe => (unit(to), [0.0; 2]),
        Kind::Directional => {
            let (s, c) = (light.radius, (1.0 - light.radius * light.radius).sqrt());
            let facing = dot(light.origin, mirrored);
            let apart = along(mirrored, -facing, light.origin);
            let inside = s > 0.0 && facing >= c;
            (if inside { mirrored } else { unit(along(light.origin.map(|x| c * x), s, unit(apart))) }, [0.5 * s; 2])
        }
        Kind::Sphere if light.radius >= distance => (mirrored, [SPREAD_MAX; 2]),
        Kind::Sphere => {
            let nearest = mirrored.map(|x| dot(to, mirrored).max(0.0) * x);
            let apart = along(nearest, -1.0, to);
            let size = dot(apart, apart).sqrt();
            let l = if size <= light.radius { nearest } else { along(to, light.radius / size, apart) };
            (unit(l), [0.5 * light.radius / distance; 2])
        }
        Kind::Rectangle | Kind::Window | Kind::Disk => {
            let hit = mirrored.map(|x| dot(light.normal, to) / dot(light.normal, mirrored).min(-1e-6) * x);
            let from_origin = along(hit, -1.0, to);
            let (center, l, sizes) = if light.kind != Kind::Disk {
                let share = |edge: V3| (dot(from_origin, edge) / dot(edge, edge)).clamp(0.0, 1.0);
                let l = along(along(to, share(light.axis), light.axis), share(light.side), light.side);
                let center = along(along(to, 0.5, light.axis), 0.5, light.side);
                (center, l, [light.axis, light.side].map(|e| (dot(e, e) / (4.0 * PI)).sqrt()))
            } else {
                let flat = along(from_origin, -dot(light.normal, from_origin), light.normal);
                let size = dot(flat, flat).sqrt();
                (to, along(to, (light.radius / size).min(1.0), flat), [0.5 * light.radius; 2])
            };
            let foreshortening = (-dot(light.normal, unit(center))).max(0.0).sqrt() / dot(center, center).sqrt();
            (unit(l), sizes.map(|s| (s * foreshortening).min(SPREAD_MAX)))
        }
    }
}

/// Shades a pixel.
pub fn shade(view: &View<'_>, p: &Pixel, incoming: &Incoming) -> Terms {
    let mut t = Terms::default();
    if p.coverage < 1e-3 || p.normal == [0.0; 3] {
        return t;
    }
    let v = unit(along(view.camera, -1.0, p.point));
    let facing = dot(p.normal, v);
    let mirrored = unit(std::array::from_fn(|k| 2.0 * facing.max(MIRRORED_MIN) * p.normal[k] - v[k]));
    let m = p.material;
    for ((light, color), unit) in view.lights.iter().zip(view.colors).zip(&incoming.unit) {
        let (l, spread) = representative(light, p.point, mirrored);
        for k in 0..3 {
            t.diffuse[k] += color[k] * unit * (1.0 - m.metallic) * m.albedo[k] / PI;
        }
        let twice_half = along(l, 1.0, v);
        if dot(p.normal, l) <= 0.0 || dot(twice_half, twice_half) < HALF_MIN {
            continue;
        }
        let alpha = (m.roughness * m.roughness).max(ALPHA_MIN);
        let normalization = spread.iter().map(|s| alpha / (alpha + s).min(1.0)).product::<f64>();
        let [_, specular] = brdf(m, p.normal, l, v);
        for k in 0..3 {
            t.specular[k] += color[k] * unit * specular[k] * normalization;
        }
    }
    let [a, b] = split_sum(view.split_sum, m.roughness, facing.clamp(1e-4, 1.0));
    let f0 = m.albedo.map(|x| 0.04 * (1.0 - m.metallic) + m.metallic * x);
    let f90 = (25.0 * dot(f0, [0.212671, 0.715160, 0.072169])).min(1.0);
    t.indirect =
        std::array::from_fn(|k| ((1.0 - m.metallic) * m.albedo[k] + f0[k] * a + f90 * b) * incoming.irradiance[k] / PI);
    for term in [&mut t.diffuse, &mut t.specular, &mut t.indirect] {
        term.iter_mut().for_each(|x| *x *= incoming.gain);
    }
    t.emission = incoming.emission;
    t
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::area_lights::{Receiver, irradiance};
    use crate::reference::brdf::Material;
    use crate::shade::environment::split_sum::table;
    use crate::transport::{AreaLight, LightShape};

    /// A mirror at normal incidence reflects the radiance of the light that it faces.
    #[test]
    fn mirrors_reflect_the_radiance_of_lights() {
        let disk = LightShape::Disk { center: [0.0, 0.0, 4.0], normal: [0.0, 0.0, -1.0], radius: 0.4 };
        let sphere = LightShape::Sphere { center: [0.0, 0.0, 4.0], radius: 0.4 };
        let square =
            LightShape::Rectangle { corner: [-0.3, -0.3, 4.0], edge_u: [0.0, 0.6, 0.0], edge_v: [0.6, 0.0, 0.0] };
        let sun = LightShape::Directional { direction: [0.0, 0.0, -1.0], angular_radius: 0.1 };
        let split_sum = table();
        for (shape, radiance) in [(disk, 1.0), (sphere, 1.0), (square, 1.0), (sun, 1.0 / (PI * 0.1_f64.sin().powi(2)))]
        {
            let light = Light::new(&AreaLight { shape, color: [1.0; 3] }.record());
            let material = Material { albedo: [1.0; 3], roughness: 0.02, metallic: 1.0 };
            let pixel = Pixel { point: [0.0; 3], normal: [0.0, 0.0, 1.0], coverage: 1.0, material };
            let receiver = Receiver { point: pixel.point, normal: pixel.normal };
            let view = View { camera: [0.0, 0.0, 9.0], lights: &[light], colors: &[[1.0; 3]], split_sum: &split_sum };
            let unit = vec![irradiance(&light, &receiver)];
            let t = shade(&view, &pixel, &Incoming { unit, irradiance: [0.0; 3], gain: 1.0, emission: [0.0; 3] });
            assert!((t.specular[0] / radiance - 1.0).abs() < 0.1, "{shape:?}: {t:?}");
        }
    }
}

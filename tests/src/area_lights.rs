//! Physical lights, receivers and discs for tests of `transport`.

use crate::lit::narrow;
use sgs_passes::reference::area_lights::{Light, Ray, Receiver};
use sgs_passes::reference::brdf::{V3, along, cross, dot, unit};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::transport::{AreaLight, LightShape, Surfels};

/// Returns a light of white color 1.
pub fn light(shape: LightShape) -> AreaLight {
    let light = AreaLight { shape, color: [1.0; 3] };
    light.check().unwrap_or_else(|e| panic!("{shape:?}: {e}"));
    light
}

/// Draws a vector with coordinates in (-scale, scale).
pub fn vector(rng: &mut Pcg, scale: f64) -> [f32; 3] {
    [0; 3].map(|_| (scale * rng.range(-1.0, 1.0)) as f32)
}

/// Draws a light of each shape around the origin. `distance` and `size` are approximate.
pub fn one_of_each(rng: &mut Pcg, distance: f64, size: f64) -> Vec<AreaLight> {
    let wide = |v: V3| v.map(|x| x as f32);
    let mut place = || {
        let direction = unit([rng.normal(), rng.normal(), rng.normal()]);
        // Turned towards the origin, roughly.
        let facing = unit(along(vector(rng, 0.5).map(f64::from), -1.0, direction));
        (wide(direction.map(|x| distance * x)), wide(facing))
    };
    let [a, b, c, d, e, f, g] = [0; 7].map(|_| place());
    let u = unit(cross(c.1.map(f64::from), [0.3, 0.5, 0.8]));
    let v = cross(c.1.map(f64::from), u);
    let half = along(u.map(|x| -0.5 * size * x), -0.35 * size, v);
    vec![
        light(LightShape::Point { position: a.0 }),
        light(LightShape::Sphere { center: b.0, radius: (0.5 * size) as f32 }),
        light(LightShape::Rectangle {
            corner: wide(along(c.0.map(f64::from), 1.0, half)),
            edge_u: wide(u.map(|x| size * x)),
            edge_v: wide(v.map(|x| 0.7 * size * x)),
        }),
        light(LightShape::Disk { center: d.0, normal: d.1, radius: (0.5 * size) as f32 }),
        light(LightShape::Spot { position: e.0, axis: e.1, inner_angle: 0.2, outer_angle: 0.9 }),
        light(LightShape::Directional { direction: f.1, angular_radius: 0.0 }),
        light(LightShape::Directional { direction: g.1, angular_radius: (0.5 * size / distance).atan() as f32 }),
        light(LightShape::Lobe { position: f.0, axis: f.1, sharpness: (4.0 / size) as f32 }),
    ]
}

/// Draws receivers with any normals.
pub fn receivers(rng: &mut Pcg, count: usize, scale: f64) -> Vec<Receiver> {
    let one = |_| {
        let point = vector(rng, scale).map(f64::from);
        Receiver { point, normal: unit([rng.normal(), rng.normal(), rng.normal()]).map(narrow) }
    };
    (0..count).map(one).collect()
}

/// Draws discs in a shell around the origin, most of them facing it.
pub fn discs(rng: &mut Pcg, count: usize) -> Surfels {
    let mut surfels = Surfels::default();
    for _ in 0..count {
        let direction = unit([rng.normal(), rng.normal(), rng.normal()]);
        let near = rng.range(0.8, 1.6);
        let normal = unit(along(vector(rng, 0.8).map(f64::from), -1.0, direction));
        surfels.points.push(direction.map(|x| (near * x) as f32));
        surfels.normals.push(normal.map(|x| x as f32));
        surfels.radii.push(rng.range(0.05, 0.3) as f32);
    }
    surfels
}

/// Returns whether a ray surely meets a disc, and whether it may by rounding.
pub fn hits(surfels: &Surfels, ray: &Ray) -> (bool, bool) {
    let (mut sure, mut possible) = (false, false);
    for i in 0..surfels.points.len() {
        let [point, normal] = [surfels.points[i], surfels.normals[i]].map(|v| v.map(f64::from));
        let (normal, radius) = (unit(normal), f64::from(surfels.radii[i]));
        let to = along(point, -1.0, ray.from);
        let facing = dot(normal, ray.along);
        let doubt = 1e-5 * (1.0 + dot(to, to).sqrt()) / facing.abs().max(1e-9);
        let t = dot(normal, to) / facing;
        let beside = along(ray.along.map(|x| t * x), -1.0, to);
        let distance = dot(beside, beside).sqrt();
        sure |= facing < -1e-5 && t > doubt && t < ray.reach - doubt && distance < radius - doubt;
        possible |= facing < 1e-5 && t > -doubt && t < ray.reach + doubt && distance < radius + doubt;
    }
    (sure, possible)
}

/// Returns the irradiance of a receiver that faces the light, roughly: the scale of rounding errors.
pub fn scale(light: &Light, r: &Receiver) -> f64 {
    use sgs_passes::reference::area_lights::Kind;
    let to = along(light.origin, -1.0, r.point);
    let square = dot(to, to);
    let pi = std::f64::consts::PI;
    match light.kind {
        Kind::Directional => 1.0,
        Kind::Point | Kind::Spot | Kind::Lobe => 1.0 / square.max(1e-3),
        Kind::Sphere | Kind::Disk => pi * (light.radius.powi(2) / square).min(1.0),
        Kind::Rectangle | Kind::Window => {
            let center = along(along(to, 0.5, light.axis), 0.5, light.side);
            let turn = cross(light.axis, light.side);
            (dot(turn, turn).sqrt() / dot(center, center)).min(pi)
        }
    }
}

//! Reference of `transport_lights`: irradiance from physical lights of color 1.
//!
//! Everything with an extent is a polygon, clipped at the horizon (Sutherland and Hodgman 1974) and integrated by
//! Lambert's formula. Disks, and the cones that spheres and directional lights subtend, have [`SIDES`] sides.
//! Directional light arrives along rays that leave the room through an opening.

use super::brdf::{V3, along, cross, dot, unit};
use crate::rng::{random_bits, uniform_from};
use crate::transport::{Outside, Sky};
use sgs_shaders::structs::LightRecord;
use std::f64::consts::{PI, TAU};

/// Number of sides of polygons that replace disks.
pub const SIDES: usize = 1024;
/// Square of the distance below which points, spots and lobes are not nearer.
const NEAR_SQUARED: f64 = 1e-3;
/// Distance of directional lights.
const FAR: f64 = 1e15;
/// Kind of windows in records.
const WINDOW: u32 = 7;
/// Stands for the index of the light in the sample points of windows.
const WINDOW_POINTS: u32 = 0x7fff_ffff;

/// Shape of a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Point.
    Point,
    /// Sphere.
    Sphere,
    /// Rectangle, on one side.
    Rectangle,
    /// Disk, on one side.
    Disk,
    /// Point with a cone.
    Spot,
    /// Distant disk.
    Directional,
    /// Point with a spherical Gaussian.
    Lobe,
    /// Rectangle that shows the environment.
    Window,
}

/// Record of the device in double precision; see `area_light.glsl`.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Shape.
    pub kind: Kind,
    /// Position, center, corner, or unit direction to the light.
    pub origin: V3,
    /// First edge, unit tangent, or unit axis.
    pub axis: V3,
    /// Second edge or unit tangent.
    pub side: V3,
    /// Unit normal of the side that emits.
    pub normal: V3,
    /// Radius, sine of the angular radius, factor of the cosine, or sharpness.
    pub radius: f64,
    /// Added to the scaled cosine; channel of a window.
    pub bias: f64,
}

impl Light {
    /// Converts a record.
    pub fn new(r: &LightRecord) -> Light {
        let kinds = [Kind::Point, Kind::Sphere, Kind::Rectangle, Kind::Disk, Kind::Spot, Kind::Directional, Kind::Lobe];
        let kind = if r.kind == WINDOW { Kind::Window } else { kinds[r.kind as usize] };
        let wide = |v: [f32; 3]| v.map(f64::from);
        Light {
            kind,
            origin: wide(r.origin),
            axis: wide(r.axis),
            side: wide(r.side),
            normal: unit(wide(r.normal)),
            radius: r.radius.into(),
            bias: r.bias.into(),
        }
    }

    /// Returns whether the light has an extent.
    pub fn has_extent(&self) -> bool {
        match self.kind {
            Kind::Point | Kind::Spot | Kind::Lobe => false,
            Kind::Directional => self.radius > 0.0,
            _ => true,
        }
    }
}

/// Receiver of light.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Position.
    pub point: V3,
    /// Unit normal or zero.
    pub normal: V3,
}

/// Sample points and shadow rays of a light.
#[derive(Clone, Copy, Debug)]
pub struct Sampling<'a> {
    /// Openings of the room, and the environment behind them.
    pub outside: &'a Outside,
    /// Distance above the surface at which rays start.
    pub offset: f64,
    /// Distance before the light at which rays end.
    pub clearance: f64,
    /// Number of sample points, a power of two.
    pub samples: u32,
    /// Seed of the sample points.
    pub seed: u32,
}

/// Shadow ray: start, unit direction, length.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start.
    pub from: V3,
    /// Unit direction.
    pub along: V3,
    /// Length.
    pub reach: f64,
}

/// Integrates the part of a polygon of radiance 1 above the horizon. It goes counterclockwise as seen from the origin.
fn polygon(vertices: &[V3], normal: V3) -> f64 {
    let mut clipped: Vec<V3> = Vec::with_capacity(vertices.len() + 2);
    for (i, &a) in vertices.iter().enumerate() {
        let b = vertices[(i + 1) % vertices.len()];
        let (ha, hb) = (dot(normal, a), dot(normal, b));
        if ha >= 0.0 {
            clipped.push(a);
        }
        if (ha > 0.0) != (hb > 0.0) && ha != hb {
            clipped.push(along(a, ha / (ha - hb), along(b, -1.0, a)));
        }
    }
    let mut sum = 0.0;
    for (i, &a) in clipped.iter().enumerate() {
        let b = clipped[(i + 1) % clipped.len()];
        let turn = cross(a, along(b, -1.0, a));
        let size = dot(turn, turn).sqrt();
        if size > 0.0 {
            sum += size.atan2(dot(a, b)) * dot(normal, turn) / size;
        }
    }
    (0.5 * sum).max(0.0)
}

/// Returns a basis of the plane across a unit vector.
fn basis(axis: V3) -> [V3; 2] {
    let start = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let u = unit(cross(start, axis));
    [u, cross(axis, u)]
}

/// Integrates a disk; `away` points along its axis, away from the receiver.
fn disk(center: V3, away: V3, radius: f64, normal: V3) -> f64 {
    let [u, v] = basis(away);
    let step = TAU / SIDES as f64;
    // The polygon has the area of the disk.
    let radius = radius * (step / step.sin()).sqrt();
    let vertices: Vec<V3> = (0..SIDES)
        .map(|i| {
            let (sin, cos) = (step * i as f64).sin_cos();
            along(along(center, radius * cos, u), radius * sin, v)
        })
        .collect();
    polygon(&vertices, normal)
}

/// Returns the irradiance of a receiver from a light of color 1, without occluders.
pub fn irradiance(light: &Light, r: &Receiver) -> f64 {
    if r.normal == [0.0; 3] {
        return 0.0;
    }
    let to = along(light.origin, -1.0, r.point);
    let square = dot(to, to);
    let cone = |axis: V3, s: f64| {
        let cosine = ((1.0 - s) * (1.0 + s)).sqrt();
        disk(axis.map(|x| cosine * x), axis, s, r.normal)
    };
    match light.kind {
        Kind::Point => dot(r.normal, unit(to)).max(0.0) / square.max(NEAR_SQUARED),
        Kind::Spot => {
            let ramp = (light.bias - light.radius * dot(light.axis, unit(to))).clamp(0.0, 1.0);
            dot(r.normal, unit(to)).max(0.0) * ramp * ramp / square.max(NEAR_SQUARED)
        }
        Kind::Lobe => {
            // A point at the light's position sees no direction.
            let leaving = dot(unit(light.axis), unit(to.map(|x| -x)));
            dot(r.normal, unit(to)).max(0.0) * (light.radius * (leaving - 1.0)).exp() / square.max(NEAR_SQUARED)
        }
        Kind::Directional if light.radius == 0.0 => dot(r.normal, light.origin).max(0.0),
        Kind::Directional => cone(unit(light.origin), light.radius) / (PI * light.radius * light.radius),
        Kind::Sphere if light.radius * light.radius >= square => PI,
        Kind::Sphere => cone(unit(to), light.radius / square.sqrt()),
        Kind::Rectangle | Kind::Window | Kind::Disk if dot(light.normal, to) >= 0.0 => 0.0,
        Kind::Rectangle | Kind::Window => {
            let far = along(to, 1.0, light.axis);
            // Backward: the corners go around the light's normal, which points to the receiver.
            polygon(&[to, along(to, 1.0, light.side), along(far, 1.0, light.side), far], r.normal)
        }
        Kind::Disk => disk(to, light.normal.map(|x| -x), light.radius, r.normal),
    }
}

/// Returns a point of the shifted sample set.
pub fn sample_point(s: u32, count: u32, shift: [f64; 2]) -> [f64; 2] {
    let x = (f64::from(s) + 0.5) / f64::from(count);
    [(x + shift[0]).fract(), (f64::from(s.reverse_bits()) / 4_294_967_296.0 + shift[1]).fract()]
}

/// Returns the geometric term of a point of a rectangle or disk.
fn geometry(light: &Light, r: &Receiver, to: V3) -> f64 {
    dot(r.normal, to).max(0.0) * (-dot(light.normal, to)).max(0.0) / dot(to, to).powi(2)
}

/// Returns the vector from a receiver to a point of a light, and its weight. `x` is uniform in a square.
pub fn sample(light: &Light, r: &Receiver, x: [f64; 2]) -> (V3, f64) {
    let to = along(light.origin, -1.0, r.point);
    // The basis of the kernel, because samples must be the same.
    let around = |axis: V3, v: V3| {
        let z = 1.0_f64.copysign(axis[2]);
        let a = -1.0 / (z + axis[2]);
        let b = axis[0] * axis[1] * a;
        let t = [1.0 + z * axis[0] * axis[0] * a, z * b, -z * axis[0]];
        let s = [b, z + axis[1] * axis[1] * a, -axis[1]];
        std::array::from_fn::<f64, 3, _>(|k| v[0] * t[k] + v[1] * s[k] + v[2] * axis[k])
    };
    let (sin, cos) = (TAU * x[1]).sin_cos();
    let cone = |axis: V3, s: f64| {
        let down = x[0] * s * s / (1.0 + (1.0 - s * s).max(0.0).sqrt());
        let sine = (down * (2.0 - down)).sqrt();
        around(axis, [sine * cos, sine * sin, 1.0 - down])
    };
    match light.kind {
        Kind::Directional => {
            let l = cone(light.origin, light.radius);
            (l.map(|x| FAR * x), dot(r.normal, l).max(0.0))
        }
        Kind::Sphere => {
            let distance = dot(to, to).sqrt();
            if light.radius >= distance {
                let l = around(r.normal, [x[0].sqrt() * cos, x[0].sqrt() * sin, (1.0 - x[0]).sqrt()]);
                let near = dot(l, to);
                let reach = near + (near * near + light.radius.powi(2) - dot(to, to)).max(0.0).sqrt();
                return (l.map(|x| reach * x), 1.0);
            }
            let l = cone(unit(to), light.radius / distance);
            let near = dot(l, to);
            let across = (dot(to, to) - near * near).max(0.0);
            let reach = near - (light.radius.powi(2) - across).max(0.0).sqrt();
            (l.map(|x| reach * x), dot(r.normal, l).max(0.0))
        }
        _ => {
            let place = if light.kind == Kind::Disk { [cos, sin].map(|t| light.radius * x[0].sqrt() * t) } else { x };
            let to = along(along(to, place[0], light.axis), place[1], light.side);
            (to, geometry(light, r, to))
        }
    }
}

/// Returns the highest point of a light above the horizon, from the receiver.
fn top(light: &Light, r: &Receiver) -> V3 {
    let to = along(light.origin, -1.0, r.point);
    let across = |axis: V3| unit(along(r.normal, -dot(r.normal, axis), axis));
    match light.kind {
        Kind::Rectangle | Kind::Window => {
            let up = |edge: V3| f64::from(u8::from(dot(r.normal, edge) >= 0.0));
            along(along(to, up(light.axis), light.axis), up(light.side), light.side)
        }
        Kind::Disk => along(to, light.radius, across(light.normal)),
        Kind::Sphere => {
            let (axis, distance) = (unit(to), dot(to, to).sqrt());
            let s = light.radius / distance;
            let c = (1.0 - s * s).max(0.0).sqrt();
            along(axis.map(|x| c * x), s, across(axis)).map(|x| distance * c * x)
        }
        _ => {
            let c = (1.0 - light.radius * light.radius).sqrt();
            along(light.origin.map(|x| c * x), light.radius, across(light.origin)).map(|x| FAR * x)
        }
    }
}

/// Returns the distance at which a ray leaves the room through an opening. `margin` reaches past the opening's edges.
pub fn leaves(outside: &Outside, from: V3, direction: V3, margin: f64) -> Option<f64> {
    let distance = |o: &crate::transport::Opening| {
        let [corner, u, v] = [o.corner, o.edge_u, o.edge_v].map(|v| v.map(f64::from));
        let across = cross(u, v);
        let (to, facing) = (along(corner, -1.0, from), dot(across, direction) / dot(across, across).sqrt());
        let t = dot(across, to) / dot(across, direction);
        let place = along(direction.map(|x| t * x), -1.0, to);
        let within = |edge: V3| {
            let (length, at) = (dot(edge, edge).sqrt(), dot(place, edge) / dot(edge, edge).sqrt());
            at >= -margin && at <= length + margin
        };
        (facing < -1e-6 && t > 0.0 && within(u) && within(v)).then_some(t)
    };
    outside.openings.iter().filter_map(distance).min_by(f64::total_cmp)
}

/// Returns the visible share of a ray to a point of a light. `visible` is that of a shadow ray.
fn reaching(light: &Light, r: &Receiver, s: &Sampling<'_>, to: V3, visible: &impl Fn(&Ray) -> f64) -> f64 {
    let (from, v) = (along(r.point, s.offset, r.normal), along(to, -s.offset, r.normal));
    let length = match light.kind {
        Kind::Directional => leaves(s.outside, from, unit(v), s.offset),
        _ => Some(dot(v, v).sqrt()),
    };
    let Some(length) = length else { return 0.0 };
    let reach = length - s.clearance;
    if reach > 0.0 { visible(&Ray { from, along: unit(v), reach }) } else { 1.0 }
}

/// Returns the radiance of a light of color 1 along a vector to it.
fn radiance(light: &Light, s: &Sampling<'_>, to: V3) -> f64 {
    match (light.kind, &s.outside.sky) {
        (Kind::Window, Some(sky)) => Sky::radiance(sky, to)[light.bias as usize],
        _ => 1.0,
    }
}

/// Returns the irradiance of a receiver from a light of color 1. `index` are those of receiver and light; `visible` is
/// the visibility of a shadow ray.
pub fn shadowed(
    light: &Light,
    r: &Receiver,
    index: (u32, u32),
    s: &Sampling<'_>,
    visible: impl Fn(&Ray) -> f64,
) -> f64 {
    let exact = irradiance(light, r);
    if exact == 0.0 {
        return 0.0;
    }
    let arriving = |to: V3| reaching(light, r, s, to, &visible) * radiance(light, s, to);
    if !light.has_extent() {
        let to = match light.kind {
            Kind::Directional => light.origin.map(|x| FAR * x),
            _ => along(light.origin, -1.0, r.point),
        };
        return exact * arriving(to);
    }
    let points = if light.kind == Kind::Window { WINDOW_POINTS } else { index.1 };
    let shift = [0, 1].map(|axis| uniform_from(random_bits(s.seed, index.0, (2 * points).wrapping_add(axis))));
    let (mut all, mut seen) = (0.0, 0.0);
    for i in 0..s.samples {
        let (to, weight) = sample(light, r, sample_point(i, s.samples, shift));
        all += weight;
        if weight > 0.0 {
            seen += weight * arriving(to);
        }
    }
    if all > 0.0 { exact * seen / all } else { exact * arriving(top(light, r)) }
}

/// Integrates the light by brute force over `side`² points. They are uniform on its surface or in directions.
pub fn integrate(light: &Light, r: &Receiver, s: &Sampling<'_>, side: u32, visible: impl Fn(&Ray) -> f64) -> f64 {
    let mut sum = 0.0;
    for i in 0..side * side {
        let x = [i % side, i / side].map(|k| (f64::from(k) + 0.5) / f64::from(side));
        let (to, weight) = sample(light, r, x);
        if weight > 0.0 {
            sum += weight * reaching(light, r, s, to, &visible) * radiance(light, s, to);
        }
    }
    let to = along(light.origin, -1.0, r.point);
    let s = match light.kind {
        Kind::Sphere => light.radius / dot(to, to).sqrt(),
        _ => light.radius,
    };
    // Solid angle of the cone.
    let cone = TAU * s * s / (1.0 + (1.0 - s * s).max(0.0).sqrt());
    let measure = match light.kind {
        Kind::Rectangle | Kind::Window if dot(light.normal, to) >= 0.0 => 0.0,
        Kind::Rectangle | Kind::Window => dot(cross(light.axis, light.side), light.normal),
        Kind::Disk => PI * light.radius * light.radius,
        Kind::Sphere if s >= 1.0 => PI,
        Kind::Sphere => cone,
        Kind::Directional => cone / (PI * s * s),
        Kind::Point | Kind::Spot | Kind::Lobe => 0.0,
    };
    sum * measure / f64::from(side * side)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;
    use crate::transport::{AreaLight, LightShape, Opening};

    /// Returns samples in a room that is open on all sides.
    fn rays(outside: &Outside) -> Sampling<'_> {
        Sampling { outside, offset: 0.0, clearance: 0.0, samples: 16, seed: 1 }
    }

    fn light(shape: LightShape) -> Light {
        Light::new(&AreaLight { shape, color: [1.0; 3] }.record())
    }

    /// Closed forms and sample measures agree, also where the horizon cuts the light.
    #[test]
    fn polygons_match_brute_force() {
        let lights = [
            light(LightShape::Sphere { center: [0.3, 0.2, 1.0], radius: 0.8 }),
            light(LightShape::Rectangle {
                corner: [-1.0, -0.5, 1.0],
                edge_u: [0.0, 1.5, 0.0],
                edge_v: [1.2, 0.0, 0.5],
            }),
            light(LightShape::Disk { center: [0.2, 0.1, 0.9], normal: [0.1, -0.3, -1.0], radius: 0.9 }),
            light(LightShape::Directional { direction: [0.3, 0.1, -1.0], angular_radius: 0.6 }),
        ];
        let outside = Outside { openings: Opening::around(1e3).to_vec(), sky: None };
        let mut rng = Pcg::new(5);
        let mut cut = 0;
        for l in &lights {
            for _ in 0..40 {
                let normal = unit([rng.normal(), rng.normal(), rng.normal()]);
                let r = Receiver { point: [0; 3].map(|_| rng.range(-0.4, 0.4)), normal };
                let (closed, summed) = (irradiance(l, &r), integrate(l, &r, &rays(&outside), 256, |_| 1.0));
                assert!((closed - summed).abs() < 2e-4 * PI, "{l:?} {r:?}: {closed} {summed}");
                let alone = shadowed(l, &r, (3, 4), &rays(&outside), |_| 1.0);
                assert!((alone - closed).abs() <= 1e-12 * closed);
                cut += usize::from(closed > 0.0 && closed < 0.1);
            }
        }
        assert!(cut > 10);
    }

    #[test]
    fn irradiance_matches_known_values() {
        let up = Receiver { point: [0.0; 3], normal: [0.0, 0.0, 1.0] };
        // A disk overhead, a sphere overhead, a sphere around the receiver, a wide rectangle.
        let disk = light(LightShape::Disk { center: [0.0, 0.0, 2.0], normal: [0.0, 0.0, -1.0], radius: 1.0 });
        assert!((irradiance(&disk, &up) - PI / 5.0).abs() < 1e-8);
        let sphere = |radius| light(LightShape::Sphere { center: [0.0, 0.0, 2.0], radius });
        assert!((irradiance(&sphere(1.0), &up) - PI / 4.0).abs() < 1e-8);
        assert_eq!(irradiance(&sphere(3.0), &up), PI);
        let sky = LightShape::Rectangle { corner: [-5e5, -5e5, 1.0], edge_u: [0.0, 1e6, 0.0], edge_v: [1e6, 0.0, 0.0] };
        assert!((irradiance(&light(sky), &up) - PI).abs() < 1e-5);
        let behind = Receiver { normal: [0.0, 0.0, -1.0], ..up };
        assert_eq!([disk, sphere(1.0), light(sky)].map(|l| irradiance(&l, &behind)), [0.0; 3]);
    }
}

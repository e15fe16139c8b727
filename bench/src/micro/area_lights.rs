//! Benchmark of physical lights: `transport_lights` at surfels and at pixels, `transport_reflect`, `transport_shade` and its
//! gradient.
//!
//! The room of `lights` with its walls cut into surfels, discs in it, and nine lights of all shapes. Some pairs and pixels
//! are checked against the reference.

use super::Context;
use super::lights::{CAMERA, Lit, bind};
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::reference::area_lights::{self as reference, Light, Ray, Receiver, Sampling};
use sgs_passes::reference::brdf::{V3, along, dot, unit};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{Bounds, Disc};
use sgs_passes::reference::transport_reflect::Room;
use sgs_passes::reference::transport_shade::{Incoming, View, shade};
use sgs_passes::shade::environment::split_sum;
use sgs_passes::shade::lights::LightModel;
use sgs_passes::transport::{
    AreaLight, AreaLights, Enclosure, LIGHT_SAMPLES, LightReceivers, LightShape, Opening, Outside, ReflectionRays,
    ShadeGradients, ShadowRays, SurfelTree, Surfels, TransportShading, parts_of, reflection_bytes, split_sum_table,
    transport_lights, transport_reflect, transport_shade, transport_shade_bwd,
};

/// Number of surfels on the walls, about.
const WALLS: u32 = 6000;
/// Number of discs in the room.
const DISCS: usize = 2000;
/// Distance of ray origins above surfaces, and of their ends before lights.
const OFFSET: f32 = 0.01;
/// Depth in which discs are reflected together.
const WINDOW: f32 = 0.02;
/// Number of rays of a reflecting pixel.
const RAYS: u32 = 8;
const SEED: u32 = 3;
/// Approximate number of pairs and of pixels that the reference evaluates.
const CHECKED: usize = 64;

/// Returns nine lights in the room.
fn lights() -> Vec<AreaLight> {
    let shapes = [
        LightShape::Point { position: [0.5, -0.6, 0.4] },
        LightShape::Sphere { center: [-0.7, -0.3, 0.8], radius: 0.1 },
        LightShape::Sphere { center: [0.9, 0.9, 1.0], radius: 0.05 },
        LightShape::Rectangle { corner: [-0.5, -1.45, 0.1], edge_u: [0.0, 0.0, 0.8], edge_v: [1.0, 0.0, 0.0] },
        LightShape::Rectangle { corner: [1.45, -0.5, 0.3], edge_u: [0.0, 1.0, 0.0], edge_v: [0.0, 0.0, -0.8] },
        LightShape::Disk { center: [0.0, 1.4, 0.5], normal: [0.0, -1.0, 0.0], radius: 0.2 },
        LightShape::Spot { position: [-1.0, -1.0, 0.0], axis: [0.6, 0.5, 0.8], inner_angle: 0.3, outer_angle: 0.8 },
        LightShape::Directional { direction: [0.3, 0.8, 0.5], angular_radius: 0.1 },
        LightShape::Lobe { position: [0.2, 1.0, -0.9], axis: [-0.1, -0.6, 0.7], sharpness: 4.0 },
    ];
    shapes.map(|shape| AreaLight { shape, color: [1.0, 0.8, 0.6] }).to_vec()
}

/// Returns a room that is open on all sides.
fn outside() -> Outside {
    Outside { openings: Opening::around(1.6).to_vec(), sky: None }
}

/// Returns surfels on the walls of the room and in it.
pub fn surfels() -> Surfels {
    let mut s = Surfels::default();
    let each = f64::from(WALLS / 6).sqrt() as u32;
    let size = 3.0 / f64::from(each);
    let place = |i: u32| (f64::from(i) + 0.5) * size - 1.5;
    for i in 0..6 * each * each {
        let (face, x, y) = (i / (each * each), place(i % each), place(i / each % each));
        let (axis, sign) = (face as usize / 2, if face % 2 == 0 { 1.0 } else { -1.0 });
        let (mut point, mut normal) = ([0.0; 3], [0.0; 3]);
        (point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3]) = (1.5 * sign, x, y);
        normal[axis] = -sign;
        s.points.push(point.map(|x| x as f32));
        s.normals.push(normal.map(|x| x as f32));
        s.radii.push((0.6 * size) as f32);
    }
    let mut rng = Pcg::new(29);
    for _ in 0..DISCS {
        s.points.push([0; 3].map(|_| rng.range(-1.2, 1.2) as f32));
        s.normals.push(unit([rng.normal(), rng.normal(), rng.normal()]).map(|x| x as f32));
        s.radii.push(rng.range(0.02, 0.06) as f32);
    }
    s
}

fn three(v: &[f32], i: usize) -> V3 {
    [v[3 * i], v[3 * i + 1], v[3 * i + 2]].map(f64::from)
}

/// Returns 1 unless a ray meets a disc.
fn visible(surfels: &Surfels, ray: &Ray) -> f64 {
    let meets = (0..surfels.points.len()).any(|i| {
        let normal = unit(surfels.normals[i].map(f64::from));
        let to = along(surfels.points[i].map(f64::from), -1.0, ray.from);
        let (facing, radius) = (dot(normal, ray.along), f64::from(surfels.radii[i]));
        let t = dot(normal, to) / facing;
        let beside = along(ray.along.map(|x| t * x), -1.0, to);
        facing < 0.0 && t > 0.0 && t < ray.reach && dot(beside, beside) <= radius * radius
    });
    f64::from(u8::from(!meets))
}

/// Checks pairs of part of a light and receiver; rays at the edge of a disc may differ.
pub fn check(
    what: &str,
    found: &[f32],
    receivers: &[Receiver],
    surfels: &Surfels,
    (lights, outside): (&[AreaLight], &Outside),
) -> anyhow::Result<()> {
    let sampling =
        Sampling { outside, offset: OFFSET.into(), clearance: OFFSET.into(), samples: LIGHT_SAMPLES, seed: SEED };
    let (lights, mut rng, mut off) = (parts_of(lights), Pcg::new(31), 0);
    for k in 0..CHECKED {
        let (l, i) = (k % lights.len(), rng.next_u32() as usize % receivers.len());
        let light = Light::new(&lights[l].record);
        let index = (i as u32, l as u32);
        let right = reference::shadowed(&light, &receivers[i], index, &sampling, |ray| visible(surfels, ray));
        let is = f64::from(found[l * receivers.len() + i]);
        off += usize::from((right - is).abs() > 1e-3 * right + 1e-5);
    }
    anyhow::ensure!(off <= CHECKED / 10, "{off} of {CHECKED} irradiances of {what} differ from the reference's.");
    Ok(())
}

/// Returns points and normals as the reference takes them.
pub fn receivers_at(points: &[[f32; 3]], normals: &[[f32; 3]]) -> Vec<Receiver> {
    let wide = |v: &[f32; 3]| v.map(f64::from);
    points.iter().zip(normals).map(|(p, n)| Receiver { point: wide(p), normal: wide(n) }).collect()
}

/// Returns surfels as receivers of the device: point, radius, normal, 0.
pub fn rows_of(surfels: &Surfels) -> Vec<f32> {
    let row = |i: usize| {
        let (p, n) = (surfels.points[i], surfels.normals[i]);
        [p[0], p[1], p[2], surfels.radii[i], n[0], n[1], n[2], 0.0]
    };
    (0..surfels.len()).flat_map(row).collect()
}

/// Returns a box around the room, and the radiosity of surfels and patches.
fn receivers_in_a_box(surfels: usize) -> anyhow::Result<(Enclosure, Vec<[f32; 3]>)> {
    let enclosure = Enclosure::new([-1.6; 3], [1.6; 3], 0.1)?;
    let mut rng = Pcg::new(31);
    let all = surfels + enclosure.patch_count() as usize;
    Ok((enclosure, (0..all).map(|_| [0; 3].map(|_| rng.range(0.2, 1.0) as f32)).collect()))
}

/// Returns the discs of surfels.
fn of_discs(surfels: &Surfels) -> Vec<Disc> {
    let disc = |i: usize| Disc {
        point: surfels.points[i].map(f64::from),
        normal: unit(surfels.normals[i].map(f64::from)),
        radius: surfels.radii[i].into(),
    };
    (0..surfels.len()).map(disc).collect()
}

/// Compares reflected radiance of some pixels with the reference. Rounding at the edge of a disc may decide some of them.
fn check_reflections(found: &[f32], room: &Room, lit: &Lit) -> anyhow::Result<()> {
    let n = lit.points.len();
    let mut off = 0;
    for i in (0..n).step_by((n / CHECKED).max(1)) {
        let right = room.reflect(CAMERA.map(f64::from), &lit.pixel(i), i as u32, [0.5; 3]);
        let close = |k: usize| (right.radiance[k] - f64::from(found[4 * i + k])).abs() <= 5e-3 * right.radiance[k];
        off += usize::from(!right.unsure && !(0..3).all(close));
    }
    anyhow::ensure!(off <= CHECKED / 10, "{off} of {CHECKED} reflections differ from the reference's.");
    Ok(())
}

/// Measures all.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let (size, model, surfels, lights) = (c.workload.largest, LightModel::default(), surfels(), lights());
    let lit = Lit::room(size, model);
    let n = lit.points.len();
    let tree = SurfelTree::new(&surfels)?;
    let mut g = Graph::new("area_lights");
    let mut b = bind(&mut g, &lit, size, model);
    let handles = tree.declare(&mut g);
    b.inputs.extend(tree.contents(&handles));
    let declared = AreaLights::declare(&mut g, lights.len() as u32);
    b.inputs.extend(declared.contents(&lights));
    let outside = outside();
    let of_outside = outside.declare(&mut g);
    b.inputs.extend(outside.contents(&of_outside));
    let rays = ShadowRays {
        tree: handles,
        outside: of_outside,
        offset: OFFSET,
        clearance: OFFSET,
        samples: LIGHT_SAMPLES,
        seed: SEED,
    };

    let count = surfels.points.len();
    let buffer = g.input("receivers", 32 * count as u64);
    b.inputs.push((buffer, bytes(&rows_of(&surfels))));
    let by_surfel = g.external("surfels_unit", 4 * (lights.len() * count) as u64);
    let receivers = LightReceivers::Surfels { receivers: buffer, count: count as u32 };
    transport_lights(&mut g, c.tuning, &receivers, &declared, &rays, None, by_surfel)?;

    let unit = g.external("unit", 4 * (lights.len() * n) as u64);
    let receivers = LightReceivers::Pixels { screen: b.pixels.screen, surfaces: b.pixels.surfaces };
    transport_lights(&mut g, c.tuning, &receivers, &declared, &rays, None, unit)?;

    let irradiance = g.external("irradiance", reflection_bytes(n as u64));
    b.inputs.push((irradiance, bytes(&vec![0.5_f32; 4 * n])));
    let (enclosure, of_receivers) = receivers_in_a_box(count)?;
    let radiosity = g.input("radiosity", 12 * of_receivers.len() as u64);
    b.inputs.push((radiosity, bytes(&of_receivers.concat())));
    let reflection = ReflectionRays {
        tree: handles,
        enclosure,
        surfels: count as u32,
        radiosity,
        offset: OFFSET,
        window: WINDOW,
        seed: SEED,
        rays: RAYS,
        mirror: 0.1,
        fade: 0.9,
        diffuse: 1.1,
    };
    transport_reflect(&mut g, &c.tuning, &b.pixels, &reflection, irradiance)?;
    let (split_sum, table) = split_sum_table(&mut g);
    b.inputs.push((split_sum, table));
    let what = TransportShading {
        pixels: b.pixels,
        lights: declared,
        unit,
        irradiance,
        reflections: false,
        emission: None,
        split_sum,
    };
    let radiance = g.external("radiance", 12 * n as u64);
    transport_shade(&mut g, c.tuning, &what, radiance, None)?;
    let into = ShadeGradients {
        materials: g.external("materials_gradient", 16 * n as u64),
        metallic: None,
        irradiance: g.external("irradiance_gradient", 16 * n as u64),
        emission: None,
        colors: g.external("colors_gradient", 12 * lights.len() as u64),
    };
    transport_shade_bwd(&mut g, c.tuning, &what, b.gradient, &into)?;

    let mut rig = Rig::new(c.device, g, b.inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let discs = tree.discs() as f64;
    let counts = |pixels: usize| Counts {
        pixels: pixels as f64,
        lights: lights.len() as f64,
        gaussians: discs,
        suns: 1.0,
        openings: outside.openings.len() as f64,
        ..Default::default()
    };
    let (of_surfels, of_pixels): (Vec<_>, Vec<_>) = times.into_iter().partition(|t| t.name == "transport_lights");
    add_passes(report, rig.plan(), &of_surfels, &counts(count), &c.ceiling);
    add_passes(report, rig.plan(), &of_pixels, &counts(n), &c.ceiling);

    let wide = |v: [f32; 3]| v.map(f64::from);
    let (by, of) = ((&lights[..], &outside), receivers_at(&surfels.points, &surfels.normals));
    check("surfels", &rig.get::<f32>(by_surfel)?, &of, &surfels, by)?;
    let found_unit: Vec<f32> = rig.get(unit)?;
    check("pixels", &found_unit, &receivers_at(&lit.points, &lit.normals), &surfels, by)?;
    let room = Room {
        discs: of_discs(&surfels),
        bounds: Bounds {
            low: enclosure.low().map(f64::from),
            high: enclosure.high().map(f64::from),
            cells: enclosure.cells(),
        },
        radiosity: of_receivers.iter().map(|b| wide(*b)).collect(),
        offset: OFFSET.into(),
        window: WINDOW.into(),
        seed: SEED,
        rays: RAYS,
        mirror: reflection.mirror.into(),
        fade: reflection.fade.into(),
        diffuse: reflection.diffuse.into(),
    };
    check_reflections(&rig.get::<f32>(irradiance)?[4 * n..], &room, &lit)?;
    let (found, materials): (Vec<f32>, Vec<f32>) = (rig.get(radiance)?, rig.get(into.irradiance)?);
    let table = split_sum::table();
    let (records, colors): (Vec<Light>, Vec<V3>) =
        lights.iter().map(|l| (Light::new(&l.record()), l.color.map(f64::from))).unzip();
    let view = View { camera: CAMERA.map(f64::from), lights: &records, colors: &colors, split_sum: &table };
    for i in (0..n).step_by((n / CHECKED).max(1)) {
        let unit = (0..lights.len()).map(|l| f64::from(found_unit[l * n + i])).collect();
        let incoming = Incoming { unit, irradiance: [0.5; 3], gain: 0.5, emission: [0.0; 3] };
        let terms = shade(&view, &lit.pixel(i), &incoming);
        let gradient = lit.gradient[i].map(f64::from);
        for k in 0..3 {
            let (right, is) = (terms.radiance()[k], three(&found, i)[k]);
            anyhow::ensure!(
                (right - is).abs() <= 1e-3 * right,
                "Radiance of pixel {i} is {is}, but should be {right}."
            );
            let (right, is) = (gradient[k] * terms.indirect[k] / 0.5, f64::from(materials[4 * i + k]));
            let off = (right - is).abs() > 1e-3 * right.abs() + 1e-7;
            anyhow::ensure!(!off, "The gradient of irradiance of pixel {i} is {is}, but should be {right}.");
        }
    }
    report.check(format!("area lights: {CHECKED} irradiances and {CHECKED} pixels are those of the reference"));
    Ok(())
}

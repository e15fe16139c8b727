//! Extreme inputs of bounced light, one line and one test each.
//!
//! docs/how/extremes.md lists the lines. Each line is a room with lights. Its transport matrix, the light of its lights and the
//! bounces are compared with the double-precision reference, and so are the gradients of the bounces.

use sgs_passes::pipeline::{TransportOptions, TransportScene};
use sgs_passes::reference::area_lights::{Light, Ray, Receiver, Sampling, shadowed};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{Disc, Matrix, V3, direction};
use sgs_passes::transport::{
    AreaLight, Enclosure, LightShape, Opening, Outside, SolveOptions, SurfelTree, Surfels, receivers,
};
use sgs_tests::area_lights::{light, scale};
use sgs_tests::transport::{By, Problem, bounds, discs, flat, random_surfels, random_values};
use sgs_tests::{Gpu, Tolerance, assert_close};
use std::f64::consts::PI;

/// Options that converge as far as 32 bits allow.
const EXACT: SolveOptions = SolveOptions { iterations: 3000, tolerance: 1e-6, least: 1e-2, accelerated: true };
const SEED: u32 = 3;

/// Room with lights. Lengths are in multiples of `length`.
#[derive(Clone)]
struct Line {
    surfels: Surfels,
    lights: Vec<AreaLight>,
    /// Radiance that surfels emit, and patches of the enclosure.
    emission: [f64; 2],
    /// Reflectance of surfels, and of patches.
    albedo: [f64; 2],
    rays: u32,
    /// Edge of a patch.
    cell: f32,
    length: f32,
    expected: Expected,
}

/// Expected property of a line, besides the reference's values.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Expected {
    /// None: some light bounces.
    Light,
    /// Nothing bounces.
    Dark,
    /// All receivers have this irradiance.
    Uniform(f64),
    /// No ray reaches the enclosure.
    Closed,
    /// No solution: light is only finite, and not negative.
    Finite,
}

/// Returns a room of random discs with a light of each kind.
fn room(count: usize) -> Line {
    let lights = vec![
        light(LightShape::Rectangle { corner: [-0.5, 1.25, -0.5], edge_u: [1.0, 0.0, 0.0], edge_v: [0.0, 0.0, 1.0] }),
        light(LightShape::Sphere { center: [1.0, 0.5, -0.25], radius: 0.25 }),
        light(LightShape::Point { position: [-0.75, 0.0, 1.0] }),
        light(LightShape::Directional { direction: [0.25, -1.0, 0.5], angular_radius: 0.1 }),
    ];
    Line {
        surfels: random_surfels(count, 70 + count as u32),
        lights,
        emission: [0.0; 2],
        albedo: [0.7, 0.5],
        rays: 16,
        cell: 1.0,
        length: 1.0,
        expected: Expected::Light,
    }
}

/// Returns a closed room: `side` by `side` discs cover each wall.
fn closed(side: usize) -> Line {
    let mut surfels = Surfels::default();
    for face in 0..6 {
        let (axis, sign) = (face / 2, if face % 2 == 0 { 1.0 } else { -1.0 });
        for at in 0..side * side {
            let place = |k: usize| (2 * k + 1) as f32 / side as f32 - 1.0;
            let (mut point, mut normal) = ([0.0; 3], [0.0; 3]);
            (point[axis], normal[axis]) = (-1.25 * sign, sign);
            (point[(axis + 1) % 3], point[(axis + 2) % 3]) = (1.25 * place(at % side), 1.25 * place(at / side));
            surfels.points.push(point);
            surfels.normals.push(normal);
            surfels.radii.push(1.8 / side as f32);
        }
    }
    Line { surfels, expected: Expected::Closed, ..room(0) }
}

fn scaled(surfels: &Surfels, by: f32) -> Surfels {
    let points = surfels.points.iter().map(|p| p.map(|x| by * x)).collect();
    Surfels { points, radii: surfels.radii.iter().map(|r| by * r).collect(), normals: surfels.normals.clone() }
}

fn check(line: &Line) {
    let gpu = Gpu::new();
    let length = line.length;
    let surfels = scaled(&line.surfels, length);
    let lights: Vec<AreaLight> = line.lights.iter().map(|l| l.scaled(length)).collect();
    lights.iter().for_each(|l| l.check().unwrap());
    let enclosure = Enclosure::new([-1.5 * length; 3], [1.5 * length; 3], line.cell * length).unwrap();
    let tree = SurfelTree::new(&surfels).unwrap();
    let (offset, clearance) = (length / 1024.0, length / 512.0);
    let options = TransportOptions { rays: line.rays, samples: 4, seed: SEED, offset, clearance };
    let scene = TransportScene::new(gpu.device(), gpu.tuning(), (&surfels, &tree), &enclosure, options).unwrap();
    let outside = Outside { openings: Opening::around(4.0 * length).to_vec(), sky: None };
    let scene = scene.with_outside(&outside).unwrap();
    let record = |r: &[f32]| {
        let [point, normal] = [&r[..3], &r[4..7]].map(|v| [v[0], v[1], v[2]].map(f64::from));
        Receiver { point, normal }
    };
    let receivers: Vec<Receiver> = receivers(&surfels, &enclosure).chunks(8).map(record).collect();
    let all = discs(&surfels);

    let targets = scene.targets().unwrap();
    check_targets(&targets, &receivers, &all, (&enclosure, offset));
    let leaves = |t: &u32| *t as usize >= surfels.len();
    let of_surfels = &targets[..surfels.len() * line.rays as usize];
    assert!(line.expected != Expected::Closed || !of_surfels.iter().any(leaves), "the room is open");

    let unit = scene.unit_light(&lights).unwrap();
    let sampling =
        Sampling { outside: &outside, offset: offset.into(), clearance: clearance.into(), samples: 4, seed: SEED };
    check_unit(&unit, &lights, &receivers, &all, &sampling);
    check_bounces(&gpu, line, &scene, Matrix { receivers: receivers.len(), targets }, &unit);
}

/// Tests the receiver that each ray meets.
fn check_targets(targets: &[u32], receivers: &[Receiver], all: &[Disc], (enclosure, offset): (&Enclosure, f32)) {
    let rays = targets.len() / receivers.len();
    let size = f64::from(enclosure.high()[0]);
    let mut unsure = 0;
    for (at, &target) in targets.iter().enumerate() {
        let (i, k) = (at / rays, (at % rays) as u32);
        let Receiver { point, normal } = receivers[i];
        if i < all.len() && !all[i].is_real() {
            assert_eq!(target, u32::MAX, "ray {k} of {i}");
            continue;
        }
        let along = direction(normal, SEED, i as u32, k, rays as u32);
        let from: V3 = std::array::from_fn(|c| point[c] + f64::from(offset) * normal[c]);
        let right = Disc::closest(all, from, along, f64::INFINITY);
        let found = ((target as usize) < all.len()).then_some(target as usize);
        unsure += usize::from(found != right);
        if found != right {
            assert!(
                Disc::may_be_closest(all, from, along, f64::INFINITY, found),
                "ray {k} of {i}: {right:?}, {found:?}"
            );
        } else if found.is_none() {
            let exits = bounds(enclosure).exits(from, along, 1e-5 * size);
            assert!(exits.contains(&(target - all.len() as u32)), "ray {k} of {i}: {exits:?}, {target}");
        }
    }
    assert!(unsure <= 5 + targets.len() / 50, "{unsure} of {} rays are unsure", targets.len());
}

/// Tests the irradiance of each receiver from each light of color 1.
fn check_unit(unit: &[f32], lights: &[AreaLight], receivers: &[Receiver], all: &[Disc], sampling: &Sampling<'_>) {
    for (at, &found) in unit.iter().enumerate() {
        let (l, i) = (at / receivers.len(), at % receivers.len());
        let (light, r) = (Light::new(&lights[l].record()), &receivers[i]);
        if i < all.len() && !r.point.iter().chain(&r.normal).all(|x| x.is_finite()) {
            assert_eq!(found, 0.0, "light {l} at {i}");
            continue;
        }
        let of = |possible: bool| {
            let hides = |d: &Disc, ray: &Ray| {
                let p = d.pass(ray.from, ray.along);
                match possible {
                    true => (p.met || p.unsure) && p.at - p.doubt < ray.reach,
                    false => p.met && !p.unsure && p.at + p.doubt < ray.reach,
                }
            };
            shadowed(&light, r, (i as u32, l as u32), sampling, |ray| {
                f64::from(u8::from(!all.iter().any(|d| hides(d, ray))))
            })
        };
        let (low, high) = (of(true), of(false));
        let slack = 2e-5 * scale(&light, r) + 1e-4 * high;
        let within = f64::from(found) >= low - slack && f64::from(found) <= high + slack;
        assert!(within, "{:?} at {r:?} ({i}): {found} outside of {low} to {high}", lights[l].shape);
    }
}

/// Tests the irradiance that bounces, and its gradients.
fn check_bounces(gpu: &Gpu, line: &Line, scene: &TransportScene, matrix: Matrix, unit: &[f32]) {
    let (n, surfels) = (matrix.receivers, line.surfels.len());
    let of = |[surfel, patch]: [f64; 2], i: usize| if i < surfels { surfel } else { patch };
    let reflectance: Vec<f32> = (0..3 * n).map(|at| of(line.albedo, at / 3) as f32).collect();
    // Channels differ.
    let emitted = |at: usize| (of(line.emission, at / 3) as f32) * [1.0, 0.5, 0.25][at % 3];
    let direct = |at: usize| unit.iter().skip(at / 3).step_by(n).sum::<f32>() * [0.25, 0.5, 1.0][at % 3];
    let source: Vec<f32> = (0..3 * n).map(|at| emitted(at) + direct(at) * reflectance[at] / PI as f32).collect();
    let wide = |values: &[f32]| -> Vec<V3> { values.chunks(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect() };
    let top = |v: &[f64]| v.iter().fold(0.0, |m: f64, x| m.max(x.abs()));

    let usual = scene.solve(&reflectance, &source, &SolveOptions::default()).unwrap();
    assert!(usual.iter().all(|e| e.is_finite() && *e >= 0.0), "irradiance is negative or not finite");
    if line.expected == Expected::Finite {
        let most = usual.iter().fold(0.0_f32, |m, e| m.max(*e));
        let each = source.iter().fold(0.0_f32, |m, s| m.max(*s));
        let bounces = SolveOptions::default().iterations.pow(2) as f32;
        assert!(most > 0.0 && most < PI as f32 * each * bounces, "{most} from {each}");
        return;
    }
    let found = scene.solve(&reflectance, &source, &EXACT).unwrap();
    let (_, right) = matrix.solve(&wide(&reflectance), &wide(&source));
    let right = flat(&right);
    assert_close("irradiance", &right, &found, Tolerance::new(1e-5 * top(&right) + 1e-30, 1e-4));
    match line.expected {
        Expected::Dark => assert!(found.iter().chain(&usual).all(|e| *e == 0.0), "light bounces"),
        Expected::Uniform(value) => {
            let uniform: Vec<f64> = (0..3 * n).map(|at| value * [1.0, 0.5, 0.25][at % 3]).collect();
            assert_close("irradiance", &uniform, &found, Tolerance::new(0.0, 1e-4));
        }
        _ => assert!(found.iter().any(|e| *e > 0.0), "no light bounces"),
    }

    let mut rng = Pcg::new(5);
    let [g, h] = [0; 2].map(|_| random_values(n, [-1.0, 1.0], &mut rng));
    let problem = Problem { matrix, reflectance: wide(&reflectance), sources: vec![wide(&source)] };
    let by = By { radiosity: Some(std::slice::from_ref(&g)), irradiance: Some(std::slice::from_ref(&h)) };
    let gradients = problem.gradients(gpu, &EXACT, &[wide(&found)], by);
    let (of_source, of_reflectance) = problem.matrix.solve_bwd(&problem.reflectance, &wide(&found), &g, &h);
    for (name, right, found) in [
        ("gradient of the source", flat(&of_source), &gradients.sources[0]),
        ("gradient of the reflectance", flat(&of_reflectance), &gradients.reflectance),
    ] {
        assert_close(name, &right, found, Tolerance::new(2e-5 * top(&right) + 1e-30, 2e-4));
    }
}

/// Returns the line with some surfels that no ray can meet.
fn with_unreal(mut line: Line) -> Line {
    let s = &mut line.surfels;
    s.points[0][1] = f32::NAN;
    s.points[1][0] = f32::INFINITY;
    s.normals[2] = [f32::NAN; 3];
    line
}

/// Returns the line with lights whose centers or corners are those of surfels.
fn with_lights_in_surfels(line: Line) -> Line {
    let lights = (0..5).map(|i| {
        let center = line.surfels.points[i];
        light(match i {
            0 => LightShape::Point { position: center },
            1 => LightShape::Sphere { center, radius: 0.05 },
            2 => LightShape::Rectangle { corner: center, edge_u: [0.5, 0.0, 0.0], edge_v: [0.0, 0.5, 0.0] },
            3 => LightShape::Disk { center, normal: line.surfels.normals[i], radius: 0.5 },
            _ => LightShape::Lobe { position: center, axis: line.surfels.normals[i], sharpness: 1e4 },
        })
    });
    Line { lights: lights.collect(), ..line }
}

/// Declares a test for each line, and the list of all.
macro_rules! lines {
    ($($name:ident: $what:literal, $line:expr;)*) => {
        $(#[test] fn $name() { check(&$line); })*
        const LINES: &[(&str, &str)] = &[$((stringify!($name), $what)),*];
    };
}

lines! {
    no_emitter: "no emitter", Line { lights: vec![], expected: Expected::Dark, ..room(60) };
    every_surfel_emits: "every surfel and patch emits", Line {
        lights: vec![], emission: [2.0; 2], albedo: [0.5; 2], expected: Expected::Uniform(4.0 * PI), ..room(60) };
    no_surfel: "no surfel", room(0);
    one_surfel: "one surfel", room(1);
    one_ray: "one ray per surfel, and six patches", Line { rays: 1, cell: 9.0, ..room(60) };
    closed_room: "a closed room", closed(4);
    open_room: "an open room: the enclosure reflects nothing", Line { albedo: [0.7, 0.0], ..room(60) };
    albedo_of_zero: "an albedo of 0", Line { albedo: [0.0; 2], expected: Expected::Dark, ..room(60) };
    albedo_of_099: "an albedo of 0.99, in a closed room", Line { albedo: [0.99; 2], ..closed(4) };
    albedo_of_one: "an albedo of 1, in an open room", Line { albedo: [1.0, 0.0], ..room(60) };
    albedo_of_one_in_a_closed_room: "an albedo of 1, in a closed room", Line {
        albedo: [1.0; 2], expected: Expected::Finite, ..closed(4) };
    lights_in_surfels: "lights at the centers of surfels", with_lights_in_surfels(room(60));
    lights_in_walls: "lights in the walls of a closed room", with_lights_in_surfels(closed(4));
    a_light_around_the_room: "a room within a spherical light", Line {
        lights: vec![light(LightShape::Sphere { center: [0.0; 3], radius: 9.0 })], ..room(60) };
    lengths_of_1e_minus_4: "lengths of 1e-4", Line { length: 1e-4, ..room(60) };
    lengths_of_1e6: "lengths of 1e6", Line { length: 1e6, ..room(60) };
    radii_of_all_sizes: "radii of 1e-6 to 1e3", {
        let mut line = room(60);
        line.surfels.radii.iter_mut().enumerate().for_each(|(i, r)| *r = 10_f32.powi(i as i32 % 10 - 6));
        line
    };
    coincident_surfels: "100 surfels in one place", {
        let mut line = room(100);
        line.surfels.points.fill([0.0, -0.5, 0.0]);
        line.surfels.normals.fill([0.0, 1.0, 0.0]);
        line
    };
    surfels_that_are_no_numbers: "surfels that are NaN or infinite", with_unreal(room(60));
}

/// docs/how/extremes.md lists every line of this file.
#[test]
fn the_documentation_lists_every_line() {
    let text = include_str!("../../../docs/how/extremes.md");
    let rows: Vec<&str> =
        text.lines().filter(|l| l.contains(" | `transport_extremes::") && l.matches('|').count() == 3).collect();
    for (name, what) in LINES {
        let row = format!("| {what} | `transport_extremes::{name}` |");
        assert!(rows.contains(&row.as_str()), "docs/how/extremes.md lacks\n{row}");
    }
    assert_eq!(rows.len(), LINES.len(), "docs/how/extremes.md has a line too many");
}

#[test]
#[should_panic(expected = "irradiance")]
fn wrong_bounces_are_detected() {
    let line = closed(2);
    let gpu = Gpu::new();
    let enclosure = Enclosure::new([-1.5; 3], [1.5; 3], 1.0).unwrap();
    let tree = SurfelTree::new(&line.surfels).unwrap();
    let options = TransportOptions { rays: 16, samples: 4, seed: SEED, offset: 1e-3, clearance: 1e-3 };
    let scene = TransportScene::new(gpu.device(), gpu.tuning(), (&line.surfels, &tree), &enclosure, options).unwrap();
    let mut targets = scene.targets().unwrap();
    targets[0] = targets[17];
    let matrix = Matrix { receivers: scene.receivers() as usize, targets };
    check_bounces(&gpu, &line, &scene, matrix, &scene.unit_light(&line.lights).unwrap());
}

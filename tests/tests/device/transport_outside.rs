//! Light from outside of a room on a device against its reference: the sun through openings, the sky in windows.

use super::transport_lights::Case;
use sgs_passes::reference::area_lights::{self as reference, Light, Receiver};
use sgs_passes::reference::brdf::{V3, cross, dot, unit};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::environment::latlong::direction;
use sgs_passes::transport::{AreaLight, LightShape, Opening, Outside, Sky, Surfels, parts_of};
use sgs_tests::Gpu;
use sgs_tests::area_lights::{discs, light, one_of_each, receivers, vector};

fn wide(v: V3) -> [f32; 3] {
    v.map(|x| x as f32)
}

/// Draws an opening at a distance, which faces the origin, roughly.
fn opening(rng: &mut Pcg, distance: f64, size: f64) -> Opening {
    let outward = unit([rng.normal(), rng.normal(), rng.normal()]);
    let tilt = vector(rng, 0.3).map(f64::from);
    let inward = unit([0, 1, 2].map(|k| tilt[k] - outward[k]));
    let u = unit(cross(inward, [0.3, 0.5, 0.8]));
    let v = cross(inward, u);
    let corner = [0, 1, 2].map(|k| distance * outward[k] - 0.5 * size * (u[k] + v[k]));
    Opening { corner: wide(corner), edge_u: wide(u.map(|x| size * x)), edge_v: wide(v.map(|x| size * x)) }
}

/// Returns suns from a point to half of all directions.
fn suns() -> Vec<AreaLight> {
    let sun = |direction: [f32; 3], angular_radius: f32| light(LightShape::Directional { direction, angular_radius });
    vec![
        sun([0.3, -1.0, 0.2], 0.0),
        sun([0.3, -1.0, 0.2], 0.0047),
        sun([-1.0, -0.4, 0.7], 0.3),
        sun([0.0, 0.0, -1.0], 1.57),
        sun([0.0, 0.0, -1.0], 0.0),
    ]
}

#[test]
fn sun_enters_through_openings_alone() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(41);
    for (count, size, samples) in [(0, 3.0, 16), (60, 2.0, 8), (400, 3.0, 1)] {
        let openings: Vec<Opening> = (0..5).map(|_| opening(&mut rng, 3.0, size)).collect();
        let outside = Outside { openings, sky: None };
        let (lights, surfels) = (suns(), discs(&mut rng, count));
        let receivers = receivers(&mut rng, 130, 0.9);
        let case =
            Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &outside, samples, list: None };
        let doubtful = case.check(&gpu);
        assert!(doubtful < 60, "{doubtful} pairs are doubtful");
        let found = case.surfels(&gpu);
        let lit = found.iter().filter(|e| **e > 0.0).count();
        assert!(lit > found.len() / 50 && lit < found.len() / 2, "{lit} of {} are lit", found.len());
        // A comparison with a room that is open on all sides fails.
        let open = Outside { openings: Opening::around(3.0).to_vec(), sky: None };
        assert!(Case { outside: &open, ..case }.compare(&gpu, &found).0.is_some());
    }
}

/// Tests openings without an area, along the rays and seen from outside.
///
/// Also tests a room without openings.
#[test]
fn sun_is_dark_where_no_opening_faces_it() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(43);
    let receivers = receivers(&mut rng, 90, 0.5);
    let surfels = Surfels::default();
    let square = |corner, edge_u, edge_v| Opening { corner, edge_u, edge_v };
    let flat = square([-2.0, -2.0, 3.0], [4.0, 0.0, 0.0], [0.0; 3]);
    let point = square([0.0, 0.0, 3.0], [0.0; 3], [0.0; 3]);
    // In a plane that the ray of the last sun does not leave, and facing away.
    let aligned = square([0.0, -4.0, -4.0], [0.0, 8.0, 0.0], [0.0, 0.0, 8.0]);
    let reversed = square([-9.0, -9.0, 3.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0]);
    let behind = square([-9.0, -9.0, -3.0], [0.0, 18.0, 0.0], [18.0, 0.0, 0.0]);
    for openings in [vec![], vec![flat], vec![point], vec![aligned], vec![reversed], vec![behind]] {
        let outside = Outside { openings, sky: None };
        let lights = suns();
        let sun = |lights| Case {
            lights,
            receivers: &receivers,
            surfels: &surfels,
            outside: &outside,
            samples: 16,
            list: None,
        };
        sun(&lights).check(&gpu);
        let overhead = sun(&lights[4..]).surfels(&gpu);
        assert!(overhead.iter().all(|e| *e == 0.0), "{:?}", outside.openings);
    }
    // The opening that faces it lets all of it in.
    let facing = square([-9.0, -9.0, 3.0], [0.0, 18.0, 0.0], [18.0, 0.0, 0.0]);
    let outside = Outside { openings: vec![flat, aligned, facing], sky: None };
    let lights = suns()[4..].to_vec();
    let case =
        Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &outside, samples: 1, list: None };
    for (e, r) in case.surfels(&gpu).iter().zip(&receivers) {
        assert!((f64::from(*e) - r.normal[2].max(0.0)).abs() < 1e-6);
    }
    // Light from inside does not depend on openings.
    let inside: Vec<AreaLight> = one_of_each(&mut rng, 2.0, 1.0)[..5].to_vec();
    let closed = Outside::default();
    let case = Case { lights: &inside, ..case };
    assert_eq!(case.surfels(&gpu), Case { outside: &closed, ..case }.surfels(&gpu));
}

/// Returns a map of a function of the direction.
fn map(size: [u32; 2], of: impl Fn([f64; 3]) -> [f64; 3]) -> Sky {
    let pixels = (0..size[1]).flat_map(|row| (0..size[0]).map(move |column| (column, row)));
    let data: Vec<f32> = pixels.flat_map(|(x, y)| of(direction(size, x, y)).map(|v| v as f32)).collect();
    Sky::new(&data, size).unwrap()
}

fn windows(rng: &mut Pcg, distance: f64, size: f64) -> Vec<AreaLight> {
    let of = |o: Opening| LightShape::Window { corner: o.corner, edge_u: o.edge_u, edge_v: o.edge_v };
    (0..3).map(|_| light(of(opening(rng, distance, size)))).collect()
}

fn as_rectangle(window: &AreaLight) -> AreaLight {
    let LightShape::Window { corner, edge_u, edge_v } = window.shape else { panic!("{window:?}") };
    light(LightShape::Rectangle { corner, edge_u, edge_v })
}

#[test]
fn window_onto_a_constant_sky_is_a_rectangle() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(47);
    let windows = windows(&mut rng, 2.0, 1.5);
    let rectangles: Vec<AreaLight> = windows.iter().map(as_rectangle).collect();
    let receivers = receivers(&mut rng, 120, 0.9);
    let surfels = Surfels::default();
    for sky in [None, Some(Sky::uniform([1.0; 3])), Some(map([64, 32], |_| [1.0; 3]))] {
        let outside = Outside { openings: Vec::new(), sky };
        let case = Case {
            lights: &windows,
            receivers: &receivers,
            surfels: &surfels,
            outside: &outside,
            samples: 8,
            list: None,
        };
        let (found, right) = (case.surfels(&gpu), Case { lights: &rectangles, ..case }.surfels(&gpu));
        let count = receivers.len();
        for (part, row) in found.chunks(count).enumerate() {
            for (a, b) in row.iter().zip(&right[part / 3 * count..]) {
                assert!((a - b).abs() <= 1e-6 * b, "part {part}: {a} {b}");
            }
        }
        assert!(found.iter().filter(|e| **e > 0.0).count() > found.len() / 10);
    }
}

#[test]
fn windows_match_the_reference_with_occluders() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(53);
    for (size, count, samples) in [([64, 32], 60, 16), ([7, 3], 200, 4), ([1, 1], 20, 2), ([2, 1], 0, 1)] {
        let mut values = || rng.range(0.0, 4.0);
        let data: Vec<f32> = (0..3 * size[0] * size[1]).map(|_| values() as f32).collect();
        let outside = Outside { openings: Vec::new(), sky: Sky::new(&data, size) };
        let (lights, surfels) = (windows(&mut rng, 2.5, 2.0), discs(&mut rng, count));
        let receivers = receivers(&mut rng, 80, 0.7);
        let case =
            Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &outside, samples, list: None };
        let doubtful = case.check(&gpu);
        assert!(doubtful < 150, "{doubtful} pairs are doubtful");
        // Channels are not those of each other.
        let mut found = case.surfels(&gpu);
        if size[0] > 1 {
            found.rotate_left(receivers.len());
            assert!(case.compare(&gpu, &found).0.is_some());
        }
    }
}

/// Sky of one hemisphere: the mean over receivers is that of the integral, and windows that face the other are dark.
#[test]
fn window_onto_a_hemisphere_matches_quadrature() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(59);
    let of = |d: V3| if d[1] > 0.0 { [1.0, 2.0, 0.5] } else { [0.0, 1.0, 0.0] };
    let outside = Outside { openings: Vec::new(), sky: Some(map([64, 32], of)) };
    let (lights, surfels) = (windows(&mut rng, 2.0, 2.0), Surfels::default());
    let receivers: Vec<Receiver> = receivers(&mut rng, 400, 0.8);
    let case =
        Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &outside, samples: 16, list: None };
    let found = case.surfels(&gpu);
    let mut part_sums = Vec::new();
    for (part, row) in parts_of(&lights).iter().zip(found.chunks(receivers.len())) {
        let light = Light::new(&part.record);
        let truth: Vec<f64> =
            receivers.iter().map(|r| reference::integrate(&light, r, &case.sampling(), 64, |_| 1.0)).collect();
        let [sum, right] = [row.iter().map(|e| f64::from(*e)).sum::<f64>(), truth.iter().sum::<f64>()];
        assert!((sum - right).abs() < 0.01 * right + 0.01, "{light:?}: {sum} {right}");
        let square: f64 = row.iter().zip(&truth).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum();
        let energy: f64 = truth.iter().map(|b| b * b).sum();
        assert!(square.sqrt() <= 0.15 * energy.sqrt() + 0.01, "{light:?}");
        part_sums.push(sum);
    }
    // Red is half of blue's double, and both are that of the upper hemisphere alone.
    for sums in part_sums.chunks(3) {
        assert!((sums[0] - 2.0 * sums[2]).abs() < 1e-4 * sums[0] + 1e-6 && sums[1] >= sums[0], "{sums:?}");
    }
    // From below, a window in the floor shows the lower hemisphere.
    let floor =
        light(LightShape::Window { corner: [-1.0, -2.0, -1.0], edge_u: [0.0, 0.0, 2.0], edge_v: [2.0, 0.0, 0.0] });
    assert!(dot(Light::new(&floor.record()).normal, [0.0, 1.0, 0.0]) > 0.0);
    let lights = [floor];
    let found = Case { lights: &lights, ..case }.surfels(&gpu);
    assert!(found[..receivers.len()].iter().all(|e| *e == 0.0), "red of the lower hemisphere is black");
    assert!(found[receivers.len()..2 * receivers.len()].iter().any(|e| *e > 0.1));
}

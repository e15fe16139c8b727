//! Rays, patches and irradiance of Gaussians against their references.

use sgs_engine::graph::Graph;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{Disc, V3, direction, gather, gather_bwd};
use sgs_passes::transport::{
    Enclosure, EnclosureError, GatherColumns, GatherInputs, NEIGHBORS, NO_NEIGHBOR, NearestOptions, SurfelTree,
    Surfels, TreeError, irradiance_gather, irradiance_gather_bwd, nearest_surfels,
};
use sgs_tests::kernels::kernel;
use sgs_tests::transport::{Traced, bounds, bytes, discs, flat, random_surfels, random_unit, random_values};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

/// Reach of rays without an end.
const FAR: f32 = f32::MAX;
/// Distance of ray origins above surfaces; exact in 32 bits.
const OFFSET: f32 = 0.015625;

fn cube(half: f32, cell: f32) -> Enclosure {
    Enclosure::new([-half; 3], [half; 3], cell).unwrap()
}

/// Ray with its results on the device.
struct Found {
    from: V3,
    along: V3,
    reach: f64,
    closest: Option<usize>,
    hidden: bool,
    patch: u32,
}

/// Ray from `from` along a unit vector, as far as `reach`.
#[derive(Clone, Copy)]
struct Ray {
    from: [f32; 3],
    along: [f32; 3],
    reach: f32,
}

/// Traces single rays.
fn trace(gpu: &Gpu, surfels: &Surfels, enclosure: &Enclosure, rays: &[Ray]) -> Vec<Found> {
    let tree = SurfelTree::new(surfels).unwrap();
    let mut g = Graph::new("surfel_rays");
    let handles = tree.declare(&mut g);
    let records: Vec<f32> = rays.iter().flat_map(|r| [&r.from[..], &[r.reach], &r.along, &[0.0]].concat()).collect();
    let buffer = g.input("rays", 4 * records.len() as u64);
    let found = g.external("found", 12 * rays.len() as u64);
    let shape = enclosure.shape();
    let push = [bytes(&[shape.low, shape.high]), bytes(&shape.cells), bytes(&[rays.len() as u32])].concat();
    g.pass("surfel_rays", &kernel("surfel_rays"))
        .bind("surfel_nodes", handles.nodes)
        .bind("surfel_discs", handles.discs)
        .bind("rays", buffer)
        .bind("found", found)
        .push(&push)
        .dispatch([rays.len().div_ceil(64) as u32, 1, 1])
        .unwrap();
    let mut inputs = vec![(buffer, bytes(&records))];
    inputs.extend(tree.contents(&handles));
    let out: Vec<u32> = gpu.run(g, &inputs).get(found);
    let one = |(o, r): (&[u32], &Ray)| Found {
        from: r.from.map(f64::from),
        along: r.along.map(f64::from),
        reach: f64::from(r.reach),
        closest: (o[0] != u32::MAX).then_some(o[0] as usize),
        hidden: o[1] == 1,
        patch: o[2],
    };
    out.chunks(3).zip(rays).map(one).collect()
}

/// Numbers of rays by their result.
#[derive(Debug, Default)]
struct Checked {
    met: usize,
    /// Rays whose result rounding decides.
    unsure: usize,
    wrong: Vec<usize>,
}

/// Compares rays with all discs.
fn compare(found: &[Found], all: &[Disc]) -> Checked {
    let mut checked = Checked::default();
    for (i, f) in found.iter().enumerate() {
        let right = Disc::closest(all, f.from, f.along, f.reach);
        let may = f.closest == right || Disc::may_be_closest(all, f.from, f.along, f.reach, f.closest);
        checked.met += usize::from(right.is_some());
        checked.unsure += usize::from(f.closest != right);
        checked.wrong.extend((!may || f.hidden != f.closest.is_some()).then_some(i));
    }
    checked
}

/// Tests rays against all discs.
#[track_caller]
fn check(found: &[Found], surfels: &Surfels) -> Checked {
    let checked = compare(found, &discs(surfels));
    assert!(checked.wrong.is_empty(), "{checked:?}");
    checked
}

fn random_rays(count: usize, size: f64, seed: u32) -> Vec<Ray> {
    let mut rng = Pcg::new(seed);
    (0..count)
        .map(|i| {
            let from = [0; 3].map(|_| rng.range(-1.6 * size, 1.6 * size) as f32);
            // Some rays are parallel to an axis.
            let along = match i % 16 {
                k @ 0..3 => std::array::from_fn(|axis| if axis == k { 1.0 } else { 0.0 }),
                3 => [0.0, 0.0, -1.0],
                _ => random_unit(&mut rng),
            };
            let reach = if i % 3 == 0 { rng.range(0.0, 2.0 * size) as f32 } else { FAR };
            Ray { from, along: along.map(|x| x as f32), reach }
        })
        .collect()
}

#[test]
fn rays_meet_the_first_disc_before_their_end() {
    let gpu = Gpu::new();
    for (count, least) in [(0, 0), (1, 0), (7, 3), (60, 40), (3000, 200)] {
        let surfels = random_surfels(count, count as u32);
        let found = trace(&gpu, &surfels, &cube(2.0, 0.5), &random_rays(1000, 1.0, 7));
        let checked = check(&found, &surfels);
        assert!(checked.met >= least && checked.unsure <= 10, "{count}: {checked:?}");
        // Smaller discs are other ones.
        let smaller: Vec<Disc> = discs(&surfels).iter().map(|d| Disc { radius: 0.9 * d.radius, ..*d }).collect();
        assert!(least == 0 || !compare(&found, &smaller).wrong.is_empty(), "{count}");
    }
}

#[test]
fn rays_meet_extreme_discs() {
    let gpu = Gpu::new();
    let base = random_surfels(300, 21);
    type Change<'a> = &'a dyn Fn(usize, &mut [f32; 3], &mut [f32; 3], &mut f32);
    let changed = |change: Change<'_>| {
        let mut s = base.clone();
        (0..s.len()).for_each(|i| change(i, &mut s.points[i], &mut s.normals[i], &mut s.radii[i]));
        s
    };
    let cases = [
        ("all sizes", 1.0, changed(&|i, _, _, r| *r = 10_f32.powf((i % 13) as f32 / 2.0 - 4.0))),
        ("coincident", 1.0, changed(&|_, p, n, r| (*p, *n, *r) = ([0.25, 0.5, -0.5], [0.0, 0.6, 0.8], 1.0))),
        ("one plane", 1.0, changed(&|_, p, n, _| (p[2], *n) = (0.5, [0.0, 0.0, 1.0]))),
        ("parallel planes", 1.0, changed(&|i, p, n, r| (p[2], *n, *r) = ((i % 9) as f32 / 8.0, [0.0, 0.0, -1.0], 0.5))),
        ("far from the origin", 1000.0, changed(&|_, p, _, r| (*p, *r) = (p.map(|x| 1000.0 * x), 1000.0 * *r))),
        ("small scene", 1e-3, changed(&|_, p, _, r| (*p, *r) = (p.map(|x| 1e-3 * x), 1e-3 * *r))),
        ("normals of other lengths", 1.0, changed(&|i, _, n, _| *n = n.map(|x| x * (0.5 + i as f32)))),
    ];
    for (name, size, surfels) in &cases {
        let enclosure = cube(2.0 * *size as f32, 0.5 * *size as f32);
        let checked = check(&trace(&gpu, surfels, &enclosure, &random_rays(1500, *size, 5)), surfels);
        assert!(checked.met > 50 && checked.unsure < 30, "{name}: {checked:?}");
    }
}

#[test]
fn edge_on_discs_are_missed_and_backs_are_transparent() {
    let gpu = Gpu::new();
    let surfels = Surfels {
        points: vec![[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 3.0]],
        normals: vec![[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]],
        radii: vec![0.5; 3],
    };
    let up = |reach: f32| Ray { from: [0.0; 3], along: [0.0, 0.0, 1.0], reach };
    let down = Ray { from: [0.0, 0.0, 5.0], along: [0.0, 0.0, -1.0], reach: FAR };
    let rays = [up(FAR), up(3.0), up(3.001), up(-1.0), down];
    let found = trace(&gpu, &surfels, &cube(8.0, 1.0), &rays);
    let closest: Vec<Option<usize>> = found.iter().map(|f| f.closest).collect();
    assert_eq!(closest, [Some(2), None, Some(2), None, Some(1)]);
}

#[test]
fn of_equal_distances_the_lowest_number_counts() {
    let gpu = Gpu::new();
    let one = random_surfels(100, 31);
    let all = Surfels { points: one.points.repeat(4), normals: one.normals.repeat(4), radii: one.radii.repeat(4) };
    let rays = random_rays(1000, 1.0, 9);
    let [found, again] = [&one, &all].map(|s| trace(&gpu, s, &cube(2.0, 1.0), &rays));
    assert!(found.iter().zip(&again).all(|(a, b)| a.closest == b.closest));
    assert!(found.iter().filter(|f| f.closest.is_some()).count() > 100);
}

#[test]
fn discs_that_no_ray_meets_are_not_in_the_tree() {
    let mut s = random_surfels(50, 41);
    s.points[0][1] = f32::NAN;
    s.points[1][0] = f32::INFINITY;
    s.normals[2][2] = f32::NAN;
    s.normals[3] = [0.0; 3];
    s.radii[4] = 0.0;
    s.radii[5] = -1.0;
    s.radii[6] = f32::NAN;
    s.radii[7] = f32::INFINITY;
    assert_eq!(SurfelTree::new(&s).unwrap().discs(), 42);
    let gpu = Gpu::new();
    check(&trace(&gpu, &s, &cube(2.0, 1.0), &random_rays(500, 1.0, 3)), &s);
    s.radii.pop();
    assert_eq!(SurfelTree::new(&s).unwrap_err(), TreeError::Lengths { points: 50, normals: 50, radii: 49 });
    // Many coincident discs still form a tree.
    let heap = Surfels { points: vec![[1.0; 3]; 5000], normals: vec![[0.0, 0.0, 1.0]; 5000], radii: vec![0.5; 5000] };
    assert_eq!(SurfelTree::new(&heap).unwrap().discs(), 5000);
}

#[test]
fn every_ray_leaves_through_a_patch() {
    let gpu = Gpu::new();
    for (low, high, cell) in [
        ([-2.0; 3], [2.0; 3], 0.4),
        ([-1.0, 0.0, 10.0], [4.0, 0.5, 11.0], 0.3),
        ([0.0; 3], [1e-3, 1.0, 1000.0], 2.0),
        ([-1e4; 3], [-1e4 + 1.0; 3], 0.25),
    ] {
        let enclosure = Enclosure::new(low, high, cell).unwrap();
        let patches = enclosure.patches();
        let size = high.iter().chain(&low).fold(0.0_f32, |m, x| m.max(x.abs()));
        let mut rays = Vec::new();
        let mut rng = Pcg::new(5);
        for i in 0..2000 {
            let mut from: [f32; 3] = std::array::from_fn(|k| rng.range(low[k].into(), high[k].into()) as f32);
            let axis = i % 3;
            match i % 5 {
                // On a face, slightly outside, far outside.
                0 => from[axis] = if i % 2 == 0 { low[axis] } else { high[axis] },
                1 => from[axis] = high[axis] + 1e-4,
                2 => from = from.map(|x| 3.0 * x),
                _ => {}
            }
            let along = match i % 4 {
                0 => std::array::from_fn(|k| if k == (i / 4) % 3 { if i % 8 == 0 { 1.0 } else { -1.0 } } else { 0.0 }),
                _ => random_unit(&mut rng).map(|x| x as f32),
            };
            rays.push(Ray { from, along, reach: FAR });
        }
        // No ray at all: any patch.
        rays.push(Ray { from: low, along: [0.0; 3], reach: FAR });
        rays.push(Ray { from: [f32::NAN; 3], along: [f32::NAN; 3], reach: FAR });
        let found = trace(&gpu, &Surfels::default(), &enclosure, &rays);
        let mut unsure = 0;
        for (i, f) in found.iter().enumerate() {
            assert!((f.patch as usize) < patches.len(), "ray {i}: {}", f.patch);
            if i < 2000 {
                let all = bounds(&enclosure).exits(f.from, f.along, 4e-6 * f64::from(size));
                assert!(all.contains(&f.patch), "ray {i} leaves through {all:?}, not {}", f.patch);
                unsure += usize::from(all[0] != f.patch);
            }
        }
        assert!(unsure < 80, "{unsure} of 2000 are unsure");
        // A ray from inside to the center of a patch leaves through it.
        let center: V3 = std::array::from_fn(|k| 0.5 * f64::from(low[k] + high[k]));
        for (i, p) in patches.iter().enumerate() {
            let to: V3 = std::array::from_fn(|k| f64::from(p.center[k]) - center[k]);
            let (length, facing) = (to.iter().map(|x| x * x).sum::<f64>().sqrt(), p.normal.map(f64::from));
            assert_eq!(bounds(&enclosure).exit(center, to.map(|x| x / length)), i as u32);
            assert!((0..3).map(|k| to[k] * facing[k]).sum::<f64>() < 0.0);
        }
        let area: f64 = patches.iter().map(|p| f64::from(p.area)).sum();
        let side = |k: usize| f64::from(high[k]) - f64::from(low[k]);
        let right = 2.0 * (side(0) * side(1) + side(1) * side(2) + side(2) * side(0));
        assert!((area / right - 1.0).abs() < 1e-4, "{area} {right}");
    }
}

#[test]
fn impossible_enclosures_are_refused() {
    let new = |low: f32, high: f32, cell: f32| Enclosure::new([low; 3], [high; 3], cell);
    for (low, high) in [(1.0, 1.0), (1.0, 0.0), (f32::NAN, 1.0), (0.0, f32::INFINITY), (-3e38, 3e38)] {
        assert!(matches!(new(low, high, 1.0), Err(EnclosureError::Corners { .. })), "{low} {high}");
    }
    for cell in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(new(0.0, 1.0, cell), Err(EnclosureError::Cell { .. })), "{cell}");
    }
    assert!(matches!(new(0.0, 1.0, 1e-9), Err(EnclosureError::Patches { .. })));
    assert_eq!(new(0.0, 1.0, 100.0).unwrap().patch_count(), 6);
}

#[test]
fn targets_of_receivers_match_all_discs() {
    let gpu = Gpu::new();
    for (count, rays) in [(0, 7), (1, 33), (7, 16), (3000, 4)] {
        let surfels = random_surfels(count, 50 + count as u32);
        let traced = Traced { surfels, enclosure: cube(1.5, 0.4), rays, seed: 11, offset: OFFSET };
        // Two patches have no place, or no normal.
        let first = 8 * count;
        let targets = traced.targets(&gpu, |r| {
            r[first] = f32::NAN;
            r[first + 12..first + 15].fill(0.0);
        });
        let all = discs(&traced.surfels);
        let n = count + traced.enclosure.patch_count() as usize;
        assert_eq!(targets.len(), n * rays as usize);
        assert!(targets[count * rays as usize..][..2 * rays as usize].iter().all(|t| *t == u32::MAX));
        let patches = traced.enclosure.patches();
        let (mut met, mut unsure) = (0, 0);
        for (at, &target) in targets.iter().enumerate() {
            let (i, k) = (at / rays as usize, at as u32 % rays);
            if i == count || i == count + 1 {
                continue;
            }
            let (point, normal): (V3, V3) = if i < count {
                (traced.surfels.points[i].map(f64::from), traced.surfels.normals[i].map(f64::from))
            } else {
                (patches[i - count].center.map(f64::from), patches[i - count].normal.map(f64::from))
            };
            let along = direction(normal, traced.seed, i as u32, k, rays);
            let from: V3 = std::array::from_fn(|c| point[c] + f64::from(OFFSET) * normal[c]);
            let right = Disc::closest(&all, from, along, f64::INFINITY);
            let found = ((target as usize) < count).then_some(target as usize);
            if found != right {
                assert!(Disc::may_be_closest(&all, from, along, f64::INFINITY, found), "ray {k} of {i}: {right:?}");
                unsure += 1;
            } else if found.is_none() {
                let exits = bounds(&traced.enclosure).exits(from, along, 1e-5);
                assert!(exits.contains(&(target - count as u32)), "ray {k} of {i}: {exits:?} is {target}");
            }
            met += usize::from(right.is_some());
        }
        assert!(unsure <= 5 + targets.len() / 500, "{count}: {unsure} of {} are unsure", targets.len());
        assert!(count < 7 || met > 20, "{met}");
        // Another seed turns the rays.
        assert_ne!(Traced { seed: 12, ..traced.clone() }.targets(&gpu, |_| ()), traced.targets(&gpu, |_| ()));
    }
}

#[test]
fn gaussians_gather_irradiance_and_its_gradient() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(61);
    let options = NearestOptions { normal_length: 0.25, least_distance: 0.01 };
    for (count, gaussians) in [(0, 3), (1, 5), (5, 300), (400, 777)] {
        let surfels = random_surfels(count, 62);
        let receivers = count + 24;
        let mut points: Vec<[f32; 3]> = (0..gaussians).map(|_| [0; 3].map(|_| rng.range(-1.5, 1.5) as f32)).collect();
        points[0] = [f32::NAN; 3];
        let normals: Vec<[f32; 3]> = (0..gaussians).map(|_| random_unit(&mut rng).map(|x| x as f32)).collect();
        let nearest = nearest_surfels(&points, &normals, &surfels, &options);
        let weights: Vec<f64> = nearest.weights.iter().map(|w| f64::from(*w)).collect();
        assert!(nearest.neighbors[..NEIGHBORS].iter().all(|n| *n == NO_NEIGHBOR));
        for row in weights.chunks(NEIGHBORS).skip(1) {
            let right = if count == 0 { 0.0 } else { 1.0 };
            assert!((row.iter().sum::<f64>() - right).abs() < 1e-6 && row.is_sorted_by(|a, b| a >= b), "{row:?}");
        }
        let lights = 2;
        let irradiance = random_values(receivers, [0.0, 3.0], &mut rng);
        let gradient = random_values(gaussians, [-1.0, 1.0], &mut rng);
        let log_gains: Vec<f32> = (0..gaussians).map(|_| rng.range(-2.0, 2.0) as f32).collect();
        let columns = nearest.columns(receivers as u32);

        let mut g = Graph::new("gather");
        let mut inputs = Vec::new();
        let mut input = |g: &mut Graph, name: &str, data: Vec<u8>| {
            let buffer = g.input(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let f = |x: f64| x as f32;
        // The second light does not count.
        let lit: Vec<[f32; 6]> = irradiance.iter().map(|e| [f(e[0]), f(e[1]), f(e[2]), 9.0, 9.0, 9.0]).collect();
        let four: Vec<[f32; 4]> = gradient.iter().map(|e| [f(e[0]), f(e[1]), f(e[2]), 9.0]).collect();
        let a = GatherInputs {
            gaussians: gaussians as u32,
            receivers: receivers as u32,
            lights,
            neighbors: input(&mut g, "neighbors", bytes(&nearest.neighbors)),
            weights: input(&mut g, "weights", bytes(&nearest.weights)),
            irradiance: input(&mut g, "irradiance", bytes(&lit)),
            log_gains: (count > 1).then(|| input(&mut g, "log_gains", bytes(&log_gains))),
        };
        let c = GatherColumns {
            receivers: receivers as u32,
            starts: input(&mut g, "starts", bytes(&columns.starts)),
            gaussians: input(&mut g, "gaussians", bytes(&columns.gaussians)),
            weights: input(&mut g, "column_weights", bytes(&columns.weights)),
        };
        let values_gradient = input(&mut g, "values_gradient", bytes(&four));
        let values = g.external("values", 16 * gaussians as u64);
        let back = g.external("irradiance_gradient", 12 * receivers as u64);
        irradiance_gather(&mut g, &gpu.tuning(), &a, values).unwrap();
        irradiance_gather_bwd(&mut g, &gpu.tuning(), &c, values_gradient, back).unwrap();
        let out = gpu.run(g, &inputs);

        let right: Vec<f64> = gather(&nearest.neighbors, &weights, NEIGHBORS, &irradiance)
            .iter()
            .zip(&log_gains)
            .flat_map(|(e, gain)| [e[0], e[1], e[2], if count > 1 { f64::from(*gain).exp() } else { 1.0 }])
            .collect();
        let tolerance = Tolerance::new(1e-6, 1e-5);
        assert_close("irradiance", &right, &out.get::<f32>(values), tolerance);
        let right = flat(&gather_bwd(&nearest.neighbors, &weights, NEIGHBORS, &gradient, receivers));
        let found: Vec<f32> = out.get(back);
        assert_close("gradient", &right, &found, Tolerance::new(1e-5, 1e-5));
        if count > 1 {
            // A gradient without its last Gaussian is another one.
            let less = gather_bwd(
                &nearest.neighbors,
                &weights,
                NEIGHBORS,
                &[&gradient[..gaussians - 1], &[[0.0; 3]]].concat(),
                receivers,
            );
            assert!(worst(&flat(&less), &found, Tolerance::new(1e-5, 1e-5)).unwrap().3 > 1.0);
        }
    }
}

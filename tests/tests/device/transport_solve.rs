//! Radiosity on the device against a dense solution in double precision.

use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{Matrix, V3};
use sgs_passes::transport::{Enclosure, SolveOptions, Surfels};
use sgs_tests::transport::{By, Problem, Traced, flat, random_surfels, random_unit, random_values};
use sgs_tests::{Gpu, Tolerance, assert_close, finite_difference, worst};
use std::f64::consts::PI;

/// Options that converge as far as 32 bits allow.
const EXACT: SolveOptions = SolveOptions { iterations: 300, tolerance: 1e-6, least: 1e-2, accelerated: true };

fn room(count: usize, rays: u32, seed: u32) -> Traced {
    let enclosure = Enclosure::new([-1.5; 3], [1.5; 3], 1.5).unwrap();
    Traced { surfels: random_surfels(count, seed), enclosure, rays, seed, offset: 1e-3 }
}

/// Draws a matrix of any targets; some rays meet nothing.
fn random_matrix(receivers: usize, rays: usize, seed: u32) -> Matrix {
    let mut rng = Pcg::new(seed);
    let mut target = || if rng.uniform() < 0.1 { u32::MAX } else { rng.next_u32() % receivers as u32 };
    Matrix { receivers, targets: (0..receivers * rays).map(|_| target()).collect() }
}

/// Tests radiosity and irradiance of every light.
fn check_solution(p: &Problem, gpu: &Gpu, options: &SolveOptions, relative: f64) {
    let found = p.solve(gpu, options, None);
    for (l, source) in p.sources.iter().enumerate() {
        let (radiosity, irradiance) = p.matrix.solve(&p.reflectance, source);
        let top = |v: &[V3]| flat(v).into_iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let tolerance = |v: &[V3]| Tolerance::new(0.1 * relative * top(v) + 1e-30, relative);
        assert_close("radiosity", &flat(&radiosity), &found.radiosity[l], tolerance(&radiosity));
        assert_close("irradiance", &flat(&irradiance), &found.irradiance[l], tolerance(&irradiance));
        let (iterations, change) = found.convergence[l];
        assert!(iterations < options.iterations && change <= options.tolerance, "{iterations} {change}");
    }
}

#[test]
fn one_bounce_matches_reference() {
    let gpu = Gpu::new();
    let once = SolveOptions { iterations: 1, ..SolveOptions::default() };
    // Above 65535 receivers, targets have 32 bits. Rows end within a word, or at its end.
    for (receivers, rays, lights) in
        [(1, 1, 1), (9, 5, 2), (255, 64, 1), (256, 8, 3), (1000, 9, 1), (65535, 3, 1), (65536, 5, 1)]
    {
        let p = Problem::random(random_matrix(receivers, rays, 3), lights, 1.0, 4);
        let mut rng = Pcg::new(5);
        let before: Vec<Vec<V3>> = (0..lights).map(|_| random_values(receivers, [0.0, 3.0], &mut rng)).collect();
        let found = p.solve(&gpu, &once, Some(&before));
        for l in 0..lights {
            let (radiosity, irradiance) = p.matrix.bounce(&p.reflectance, &p.sources[l], &before[l]);
            let tolerance = Tolerance::new(1e-6, 3e-6);
            assert_close("radiosity", &flat(&radiosity), &found.radiosity[l], tolerance);
            assert_close("irradiance", &flat(&irradiance), &found.irradiance[l], tolerance);
            // A comparison with another matrix fails.
            if receivers > 8 {
                let mut other = p.matrix.clone();
                other.targets.swap(0, 1);
                other.targets[0] = (other.targets[0].wrapping_add(1)) % receivers as u32;
                let (_, wrong) = other.bounce(&p.reflectance, &p.sources[l], &before[l]);
                assert!(worst(&flat(&wrong), &found.irradiance[l], tolerance).unwrap().3 > 1.0);
            }
        }
    }
}

#[test]
fn solution_matches_elimination() {
    let gpu = Gpu::new();
    for (count, rays, most) in [(0, 8, 0.9), (1, 5, 0.5), (60, 16, 0.0), (60, 16, 0.95), (120, 7, 0.7)] {
        let p = Problem::random(room(count, rays, 7).matrix(&gpu), 3, most, 8);
        check_solution(&p, &gpu, &EXACT, 2e-5);
        check_solution(&p, &gpu, &SolveOptions { accelerated: false, ..EXACT }, 2e-5);
        check_solution(&p, &gpu, &SolveOptions::default(), 4e-3);
    }
    // Rays that meet nothing, and one receiver that meets itself.
    check_solution(&Problem::random(random_matrix(70, 11, 9), 2, 1.0, 10), &gpu, &EXACT, 2e-5);
    check_solution(&Problem::random(Matrix { receivers: 1, targets: vec![0; 4] }, 1, 0.9, 11), &gpu, &EXACT, 2e-5);
}

#[test]
fn closed_furnace_is_uniform() {
    let gpu = Gpu::new();
    let matrix = room(80, 64, 13).matrix(&gpu);
    assert!(matrix.targets.iter().all(|t| (*t as usize) < matrix.receivers), "the room is open");
    for reflectance in [0.0, 0.5, 0.9, 0.99] {
        for accelerated in [false, true] {
            let n = matrix.receivers;
            let reflectance: f64 = f64::from(reflectance as f32);
            let p = Problem {
                matrix: matrix.clone(),
                reflectance: vec![[reflectance; 3]; n],
                sources: vec![vec![[0.25; 3]; n]],
            };
            let options = SolveOptions { iterations: 1500, tolerance: 3e-7, accelerated, ..EXACT };
            let found = p.solve(&gpu, &options, None);
            let right = 0.25 / (1.0 - reflectance);
            assert_close("radiosity", &vec![right; 3 * n], &found.radiosity[0], Tolerance::new(0.0, 1e-4));
            assert_close("irradiance", &vec![PI * right; 3 * n], &found.irradiance[0], Tolerance::new(0.0, 1e-4));
            println!("reflectance {reflectance}, accelerated {accelerated}: {:?}", found.convergence);
        }
    }
}

#[test]
fn open_room_is_darker_than_a_closed_one() {
    let gpu = Gpu::new();
    let closed = Problem::random(room(40, 32, 17).matrix(&gpu), 1, 0.9, 18);
    let mut open = closed.clone();
    // The upper face is open.
    let first = open.matrix.receivers as u32 - 4;
    open.matrix.targets.iter_mut().filter(|t| **t >= first).for_each(|t| *t = u32::MAX);
    check_solution(&open, &gpu, &EXACT, 2e-5);
    let [a, b] = [&closed, &open].map(|p| p.solve(&gpu, &EXACT, None).radiosity.remove(0));
    assert!(a.iter().zip(&b).all(|(a, b)| b <= &(a * 1.00001)) && b.iter().sum::<f32>() < 0.95 * a.iter().sum::<f32>());
}

#[test]
fn no_light_stays_no_light() {
    let gpu = Gpu::new();
    let mut p = Problem::random(room(10, 16, 19).matrix(&gpu), 3, 0.9, 20);
    p.sources[1].fill([0.0; 3]);
    let found = p.solve(&gpu, &EXACT, None);
    assert!(found.radiosity[1].iter().chain(&found.irradiance[1]).all(|x| *x == 0.0));
    assert_eq!(found.convergence[1], (1, 0.0));
    assert!(found.convergence[0].0 > 2 && found.convergence[2].0 > 2);
}

#[test]
fn lights_add_up() {
    let gpu = Gpu::new();
    let matrix = room(40, 16, 23).matrix(&gpu);
    let p = Problem::random(matrix, 2, 0.8, 24);
    let both: Vec<V3> = (0..p.matrix.receivers)
        .map(|i| std::array::from_fn(|c| f64::from((p.sources[0][i][c] + p.sources[1][i][c]) as f32)))
        .collect();
    let single = p.solve(&gpu, &EXACT, None);
    let together = Problem { sources: vec![both], ..p }.solve(&gpu, &EXACT, None);
    let sum: Vec<f64> =
        single.irradiance[0].iter().zip(&single.irradiance[1]).map(|(a, b)| f64::from(*a) + f64::from(*b)).collect();
    assert_close("irradiance", &sum, &together.irradiance[0], Tolerance::new(1e-4, 3e-5));
}

#[test]
fn iterations_stop_where_the_tolerance_is_reached() {
    let gpu = Gpu::new();
    let p = Problem::random(room(60, 16, 25).matrix(&gpu), 2, 0.8, 26);
    let full = p.solve(&gpu, &SolveOptions { iterations: 60, ..SolveOptions::default() }, None);
    let stop = full.convergence.iter().map(|c| c.0).max().unwrap();
    assert!((3..30).contains(&stop), "{stop}");
    // As many iterations as were needed give the same bits.
    let exact = p.solve(&gpu, &SolveOptions { iterations: stop, ..SolveOptions::default() }, None);
    assert!(exact.radiosity == full.radiosity && exact.irradiance == full.irradiance);
    // From the solution, one iteration is enough.
    let solved: Vec<Vec<V3>> = p
        .sources
        .iter()
        .map(|s| p.matrix.solve(&p.reflectance, s).0.iter().map(|v| v.map(|x| f64::from(x as f32))).collect())
        .collect();
    let warm = p.solve(&gpu, &SolveOptions::default(), Some(&solved));
    assert!(warm.convergence.iter().all(|c| c.0 == 1), "{:?}", warm.convergence);
    // Chebyshev's iteration is the faster one.
    let jacobi = p.solve(&gpu, &SolveOptions { iterations: 60, accelerated: false, ..SolveOptions::default() }, None);
    println!("iterations: {:?}, with Jacobi {:?}", full.convergence, jacobi.convergence);
    assert!(jacobi.convergence[0].0 > stop);
}

#[test]
fn scale_of_light_does_not_matter() {
    let gpu = Gpu::new();
    let p = Problem::random(room(40, 16, 45).matrix(&gpu), 1, 0.8, 46);
    let right = p.solve(&gpu, &SolveOptions::default(), None);
    for power in [-60, 60] {
        let scale = 2_f64.powi(power);
        let source = p.sources[0].iter().map(|v| v.map(|x| x * scale)).collect();
        let found = Problem { sources: vec![source], ..p.clone() }.solve(&gpu, &SolveOptions::default(), None);
        let scaled = |v: &[f32]| v.iter().map(|x| x * scale as f32).collect::<Vec<f32>>();
        assert_eq!(found.radiosity[0], scaled(&right.radiosity[0]));
        assert_eq!(found.irradiance[0], scaled(&right.irradiance[0]));
        assert_eq!(found.convergence, right.convergence);
    }
}

#[test]
fn energy_never_grows() {
    let gpu = Gpu::new();
    let mut p = Problem::random(room(50, 32, 27).matrix(&gpu), 1, 1.0, 28);
    p.reflectance.fill([1.0; 3]);
    let mut values = std::mem::replace(&mut p.sources[0], vec![[0.0; 3]; p.matrix.receivers]);
    let once = SolveOptions { iterations: 1, ..SolveOptions::default() };
    let top = |v: &[V3]| flat(v).into_iter().fold(0.0, f64::max);
    for _ in 0..5 {
        let found = p.solve(&gpu, &once, Some(&[values.clone()]));
        let next: Vec<V3> = found.radiosity[0].chunks(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect();
        assert!(top(&next) <= top(&values) * (1.0 + 1e-6));
        values = next;
    }
    // The transposed matrix distributes what a receiver has: the sum stays.
    let mut rng = Pcg::new(29);
    let n = p.matrix.receivers;
    let gradient = random_values(n, [0.0, 1.0], &mut rng);
    let found = p.gradients(
        &gpu,
        &once,
        &[vec![[0.0; 3]; n]],
        By { radiosity: Some(std::slice::from_ref(&gradient)), irradiance: None },
    );
    let sum = |v: &[f64]| v.iter().sum::<f64>();
    let found: Vec<f64> = found.sources[0].iter().map(|x| f64::from(*x)).collect();
    assert!((sum(&found) / (2.0 * sum(&flat(&gradient))) - 1.0).abs() < 1e-5);
}

#[test]
fn transport_is_reciprocal() {
    let gpu = Gpu::new();
    // Small discs on a sphere, facing its center: all see each other.
    let mut rng = Pcg::new(31);
    let mut s = Surfels::default();
    for _ in 0..12 {
        let at = random_unit(&mut rng);
        s.points.push(at.map(|x| x as f32));
        s.normals.push(at.map(|x| -x as f32));
        s.radii.push(rng.range(0.08, 0.16) as f32);
    }
    let rays = 1 << 15;
    let enclosure = Enclosure::new([-1.5; 3], [1.5; 3], 3.0).unwrap();
    let traced = Traced { surfels: s.clone(), enclosure, rays, seed: 33, offset: 1e-4 };
    let matrix = traced.matrix(&gpu);
    let share = |i: usize, j: usize| {
        let row = &matrix.targets[i * rays as usize..][..rays as usize];
        row.iter().filter(|t| **t as usize == j).count() as f64 / f64::from(rays)
    };
    let area = |i: usize| PI * f64::from(s.radii[i]).powi(2);
    let mut pairs = 0;
    for i in 0..12 {
        for j in 0..i {
            let apart: f64 = (0..3).map(|k| f64::from(s.points[i][k] - s.points[j][k]).powi(2)).sum::<f64>().sqrt();
            // Near ones are not small for each other, or overlap.
            if apart < 0.7 {
                continue;
            }
            let (a, b) = (area(i) * share(i, j), area(j) * share(j, i));
            let noise = [share(i, j), share(j, i)].map(|t| 1.0 / (t * f64::from(rays)).max(1.0).sqrt());
            let limit = 4.0 * noise[0].hypot(noise[1]) * a.max(b) + 0.03 * a.max(b);
            assert!((a - b).abs() < limit, "{i} {j}: {a} {b}, {limit}");
            // On a sphere, every form factor is area / (4 pi radius²).
            assert!((share(i, j) / (area(j) / (4.0 * PI)) - 1.0).abs() < 4.0 * noise[0] + 0.05, "{i} {j}");
            pairs += 1;
        }
    }
    assert!(pairs > 30, "{pairs}");
}

#[test]
fn gradients_match_reference() {
    let gpu = Gpu::new();
    for (count, rays, lights, most) in [(0, 8, 1, 0.9), (1, 4, 2, 0.5), (70, 16, 3, 0.9), (70, 16, 1, 0.0)] {
        let p = Problem::random(room(count, rays, 37).matrix(&gpu), lights, most, 38);
        let n = p.matrix.receivers;
        let mut rng = Pcg::new(39);
        let mut draw = || -> Vec<Vec<V3>> { (0..lights).map(|_| random_values(n, [-1.0, 1.0], &mut rng)).collect() };
        let (g, h, zero) = (draw(), draw(), vec![vec![[0.0; 3]; n]; lights]);
        let solved: Vec<Vec<V3>> = p
            .sources
            .iter()
            .map(|s| p.matrix.solve(&p.reflectance, s).1.iter().map(|v| v.map(|x| f64::from(x as f32))).collect())
            .collect();
        for (by_radiosity, by_irradiance) in [(true, true), (true, false), (false, true)] {
            let by = By { radiosity: by_radiosity.then_some(&g[..]), irradiance: by_irradiance.then_some(&h[..]) };
            let found = p.gradients(&gpu, &EXACT, &solved, by);
            let mut sum = vec![0.0; 3 * n];
            let size = flat(&solved.concat()).into_iter().fold(1.0, f64::max);
            for l in 0..lights {
                let [a, b] = [by.radiosity.unwrap_or(&zero), by.irradiance.unwrap_or(&zero)].map(|v| &v[l]);
                let (source, reflectance) = p.matrix.solve_bwd(&p.reflectance, &solved[l], a, b);
                assert_close("source", &flat(&source), &found.sources[l], Tolerance::new(2e-4, 1e-4));
                sum.iter_mut().zip(flat(&reflectance)).for_each(|(s, r)| *s += r);
            }
            assert_close("reflectance", &sum, &found.reflectance, Tolerance::new(2e-4 * size, 1e-4));
            assert!(found.convergence.iter().all(|c| c.0 < EXACT.iterations), "{:?}", found.convergence);
        }
    }
}

#[test]
fn gradients_match_finite_differences() {
    let gpu = Gpu::new();
    let p = Problem::random(room(12, 16, 41).matrix(&gpu), 1, 0.8, 42);
    let n = p.matrix.receivers;
    let mut rng = Pcg::new(43);
    let [g, h] = [0; 2].map(|_| random_values(n, [-1.0, 1.0], &mut rng));
    let dot = |a: &[V3], b: &[V3]| flat(a).iter().zip(flat(b)).map(|(a, b)| a * b).sum::<f64>();
    let loss = |x: &[f64]| {
        let all: Vec<V3> = x.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        let (radiosity, irradiance) = p.matrix.solve(&all[..n], &all[n..]);
        dot(&radiosity, &g) + dot(&irradiance, &h)
    };
    let irradiance: Vec<V3> =
        p.solve(&gpu, &EXACT, None).irradiance[0].chunks(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect();
    let [one, other] = [&g, &h].map(std::slice::from_ref);
    let by = By { radiosity: Some(one), irradiance: Some(other) };
    let found = p.gradients(&gpu, &EXACT, &[irradiance], by);
    let all = [&found.reflectance[..], &found.sources[0]].concat();
    let mut x = [flat(&p.reflectance), flat(&p.sources[0])].concat();
    let right: Vec<f64> = (0..x.len()).map(|i| finite_difference(&mut x, i, 1e-5, loss)).collect();
    let tolerance = Tolerance::new(1e-3, 1e-3);
    assert_close("gradients", &right, &all, tolerance);
    // Without the gradient of irradiance, they are others.
    let less = p.gradients(&gpu, &EXACT, &[vec![[1.0; 3]; n]], By { irradiance: None, ..by });
    assert!(worst(&right[3 * n..], &less.sources[0], tolerance).unwrap().3 > 1.0);
}

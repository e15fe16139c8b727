//! Training under lights with traced visibility: radiance and gradients against the reference. Each pair of light and
//! pixel is multiplied by the visibility of its ray. Views are processed in one stretch and in several.

use sgs_engine::graph::Graph;
use sgs_passes::reference::lights as reference;
use sgs_passes::reference::traced::{self as rays, Splat};
use sgs_passes::shade::lights::{
    Axes, LightModel, LightParameterGradients, Lights, Shape, lights_materials_bwd, lights_prepare, lights_prepare_bwd,
};
use sgs_passes::shade::traced::{
    TracedTree, lights_bwd_traced, lights_normals_bwd_traced, lights_split_traced, lights_train_traced,
};
use sgs_tests::lit::{Lit, SPARE, narrow};
use sgs_tests::splats::{doubt, random_splats, splat_data};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

const MODEL: LightModel = LightModel { lights: 5, lobes: 3, axes: Axes::Free };
/// Distance of ray origins above surfaces; exact in 32 bits.
const OFFSET: f32 = 0.015625;
/// Distance between ray ends and lights.
const CLEARANCE: f32 = 0.0625;

#[derive(PartialEq)]
struct Found {
    direct: Vec<f32>,
    whole: Vec<f32>,
    diffuse: Vec<f32>,
    materials: Vec<f32>,
    metallic: Vec<f32>,
    positions: Vec<f32>,
    lobes: Vec<f32>,
    normals: Vec<f32>,
    /// Mean over the lights that are on.
    visibility: Vec<f32>,
    /// Visibility by light and pixel, as shading read it; empty if not stored.
    seen: Vec<f64>,
}

fn run(gpu: &Gpu, case: &Lit, splats: &[Splat], largest: [u32; 2], shape: Shape, room: u64) -> Found {
    let tuning = gpu.tuning();
    let tree = TracedTree::new(&splat_data(splats)).unwrap();
    let mut g = Graph::new("lights_traced");
    let mut bound = case.bind(&mut g, largest);
    let mut traced = tree.declare(&mut g, OFFSET);
    (traced.room, traced.clearance) = (room, CLEARANCE);
    bound.inputs.extend(tree.contents(&traced));
    let (pixels, model, n) = (bound.pixels, case.raw.model, case.pixels.len());
    let step = pixels.screen.step;
    let prepared = lights_prepare(&mut g, tuning, "prepare", step, model, &bound.parameters, None).unwrap();
    let what = Lights { pixels, prepared, normalizer: case.normalizer() as f32, shape };
    let many = (n + SPARE) as u64;
    let [direct, whole, diffuse] = ["direct", "whole", "diffuse"].map(|name| g.external(name, 12 * many));
    let visibility = g.external("visibility", 4 * many);
    let (sums, sight) = lights_train_traced(&mut g, &what, &traced, direct).unwrap();
    lights_split_traced(&mut g, tuning, &what, &traced, [whole, diffuse], visibility).unwrap();
    let retained = sight.seen.map(|seen| {
        let bytes = u64::from(sight.stretch) * u64::from(model.lights);
        let retained = g.external("kept", bytes);
        g.copy("keep", seen, retained).unwrap();
        retained
    });
    let [materials, metallic] = [("materials_gradient", 16), ("metallic_gradient", 4)].map(|(name, width)| {
        let buffer = g.external(name, width * many);
        bound.inputs.push((buffer, vec![0; (width * many) as usize]));
        buffer
    });
    let requested = case.metallic.then_some(metallic);
    lights_materials_bwd(&mut g, tuning, &pixels, &sums, bound.gradient, materials, requested).unwrap();
    let into = LightParameterGradients {
        positions: g.external("positions_gradient", model.position_bytes()),
        lobes: g.external("lobes_gradient", model.lobe_bytes()),
    };
    let gradients = lights_bwd_traced(&mut g, tuning, &what, &traced, &sight, bound.gradient).unwrap();
    lights_prepare_bwd(&mut g, &prepared, &bound.parameters, &gradients, None, &into).unwrap();
    let normals = g.external("normals_gradient", 12 * many);
    lights_normals_bwd_traced(&mut g, &what, &traced, &sight, bound.gradient, normals).unwrap();
    let out = gpu.run(g, &bound.inputs);
    let of = |buffer, width: usize| {
        let all: Vec<f32> = out.get(buffer);
        assert!(all[width * n..].iter().all(|x| x.to_bits() == u32::MAX), "pixels behind the view were written");
        all[..width * n].to_vec()
    };
    let byte = |l: u32, i: usize| {
        let bytes: Vec<u8> = out.get(retained.unwrap());
        f64::from(bytes[(l * sight.stretch) as usize + i]) / 255.0
    };
    let pairs = (0..model.lights).flat_map(|l| (0..n).map(move |i| (l, i)));
    Found {
        direct: of(direct, 3),
        whole: of(whole, 3),
        diffuse: of(diffuse, 3),
        materials: out.get::<f32>(materials)[..4 * n].to_vec(),
        metallic: out.get::<f32>(metallic)[..n].to_vec(),
        positions: out.get(into.positions),
        lobes: out.get(into.lobes),
        normals: of(normals, 3),
        visibility: of(visibility, 1),
        seen: if retained.is_some() { pairs.map(|(l, i)| byte(l, i)).collect() } else { vec![] },
    }
}

fn scale(x: &[f64]) -> f64 {
    (x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

/// Compares visibility with the reference, up to 8-bit rounding. Returns the number of occluded rays.
fn check_rays(case: &Lit, splats: &[Splat], seen: &[f64]) -> usize {
    let (n, mut hidden) = (case.pixels.len(), 0);
    for (l, light) in case.lights().iter().enumerate() {
        let Some(light) = light else { continue };
        for (i, p) in case.pixels.iter().enumerate() {
            let towards: f64 = (0..3).map(|k| p.normal[k] * (light.place[k] - p.point[k])).sum();
            if p.coverage < 1e-3 || towards.abs() < 1e-6 {
                continue;
            }
            let from = std::array::from_fn(|k| p.point[k] + f64::from(OFFSET) * p.normal[k]);
            let way: [f64; 3] = std::array::from_fn(|k| light.place[k] - from[k]);
            let length = way.iter().map(|x| x * x).sum::<f64>().sqrt();
            let share = (1.0 - f64::from(CLEARANCE) / length).max(0.0);
            let to = std::array::from_fn(|k| from[k] + share * way[k]);
            let right = if towards > 0.0 { rays::transmittance(splats, from, to) } else { 0.0 };
            let off = (seen[l * n + i] - right).abs();
            let doubt = if towards > 0.0 && share > 0.0 { doubt(splats, from, to) } else { 0.0 };
            assert!(off < 0.5 / 255.0 + 3e-4 + doubt, "pixel {i}, light {l}: {right} {}", seen[l * n + i]);
            hidden += usize::from(towards > 0.0 && right < 0.9);
        }
    }
    hidden
}

/// Compares the kernels' results with the reference at the visibility found.
fn check(case: &Lit, found: &Found, relative: f64) {
    let n = case.pixels.len();
    let lights = case.lights();
    let (mut diffuse, mut whole) = (vec![0.0; 3 * n], vec![0.0; 3 * n]);
    let mut materials = vec![[0.0; 5]; n];
    let (mut positions, mut lobes, mut mean) = (vec![], vec![], vec![0.0; n]);
    let mut normals = vec![0.0; 3 * n];
    let on = lights.iter().flatten().count().max(1) as f64;
    let row = case.raw.lobes.len() / lights.len();
    for (l, light) in lights.iter().enumerate() {
        let seen = |i: usize| if light.is_some() { found.seen[l * n + i] } else { 0.0 };
        let alone = [light.clone()];
        let [d, s] = reference::lights(&case.pixels, &alone, case.camera, case.normalizer());
        for i in 0..3 * n {
            diffuse[i] += seen(i / 3) * d[i];
            whole[i] += seen(i / 3) * (d[i] + s[i]);
        }
        (0..n).for_each(|i| mean[i] += seen(i) / on);
        let gradient: Vec<f64> = case.gradient.iter().enumerate().map(|(i, g)| g * seen(i / 3)).collect();
        let part = reference::lights_materials_bwd(&case.pixels, &alone, case.camera, case.normalizer(), &gradient);
        materials.iter_mut().zip(&part).for_each(|(sum, p)| (0..5).for_each(|k| sum[k] += p[k]));
        let part =
            reference::lights_normals_bwd(&case.pixels, &alone, case.camera, case.normalizer(), &gradient).concat();
        // At a zero normal, the reference's differences include lights that a step in any direction would face.
        let there = |i: usize| case.pixels[i / 3].normal != [0.0; 3];
        (0..3 * n).filter(|i| there(*i)).for_each(|i| normals[i] += part[i]);
        let mut raw = case.raw.clone();
        raw.gains.iter_mut().enumerate().for_each(|(i, g)| *g *= f64::from(i == l));
        let bwd = reference::lights_bwd(&raw, &case.pixels, case.camera, case.normalizer(), &gradient);
        positions.extend_from_slice(&bwd.positions[3 * l..3 * l + 3]);
        lobes.extend_from_slice(&bwd.lobes[row * l..row * (l + 1)]);
    }
    let close = |what: &str, expected: &[f64], is: &[f32], relative: f64| {
        assert_close(what, expected, is, Tolerance::new(1e-2 * relative * scale(expected) + 1e-20, relative));
    };
    close("radiance", &whole, &found.direct, relative);
    close("radiance of an image", &whole, &found.whole, relative);
    close("diffuse", &diffuse, &found.diffuse, relative);
    assert_close("mean", &mean, &found.visibility, Tolerance::new(1e-6, 1e-6));
    for k in 0..4 {
        let expected: Vec<f64> = materials.iter().map(|m| m[k]).collect();
        let is: Vec<f32> = found.materials.iter().skip(k).step_by(4).copied().collect();
        close(&format!("gradient {k} of materials"), &expected, &is, relative);
    }
    if case.metallic {
        let expected: Vec<f64> = materials.iter().map(|m| m[4]).collect();
        close("gradient of metallic", &expected, &found.metallic, relative);
    }
    let t = Tolerance::new(1e-4 * scale(&normals) + 1e-20, 1e-3);
    assert_close("gradient of normals", &normals, &found.normals, t);
    close("positions", &positions, &found.positions, 1e-3);
    let width = case.raw.model.row() as usize;
    for k in 0..width {
        let expected: Vec<f64> = lobes.iter().copied().skip(k).step_by(width).collect();
        let is: Vec<f32> = found.lobes.iter().copied().skip(k).step_by(width).collect();
        close(&format!("number {k} of lobes"), &expected, &is, 1e-3);
    }
}

fn own(gpu: &Gpu) -> Shape {
    Shape { per_lane: 2, ..Shape::for_device(gpu.tuning()) }
}

#[test]
fn radiance_and_gradients_match_reference_at_odd_sizes() {
    let gpu = Gpu::new();
    let splats = random_splats(300, 3);
    for (i, size) in [[1, 1], [7, 1], [9, 8], [31, 9]].into_iter().enumerate() {
        let mut case = Lit::random(size, MODEL, i % 2 == 1, i as u32);
        case.raw.gains[2] = 0.0;
        if i == 3 {
            case.pixels[4].coverage = 0.0;
            case.pixels[4].point = [f64::NAN; 3];
        }
        let largest = size.map(|s| s as u32 + 3 * u32::from(i == 2));
        let found = run(&gpu, &case, &splats, largest, own(&gpu), 1 << 20);
        let hidden = check_rays(&case, &splats, &found.seen);
        assert!(i < 2 || hidden > 20, "{hidden}");
        check(&case, &found, 2e-4);
    }
}

/// Tests that results do not depend on the capacity for visibility. Pixels are equal bit for bit, sums up to their
/// order.
#[test]
fn results_are_independent_of_stretches() {
    let gpu = Gpu::new();
    let splats = random_splats(200, 5);
    let case = Lit::random([37, 11], MODEL, true, 9);
    let shape = own(&gpu);
    let whole = run(&gpu, &case, &splats, [40, 12], shape, 1 << 20);
    check(&case, &whole, 2e-4);
    let block = u64::from(shape.block());
    for blocks in [0, 1, 2, 5, 7] {
        let cut = run(&gpu, &case, &splats, [40, 12], shape, blocks * block * u64::from(MODEL.lights));
        assert!(cut.seen.is_empty());
        assert_eq!([&cut.direct, &cut.whole, &cut.diffuse], [&whole.direct, &whole.whole, &whole.diffuse]);
        assert_eq!((&cut.materials, &cut.visibility), (&whole.materials, &whole.visibility));
        assert_eq!(cut.normals, whole.normals);
        for (a, b) in [(&cut.positions, &whole.positions), (&cut.lobes, &whole.lobes)] {
            let wide: Vec<f64> = b.iter().map(|x| f64::from(*x)).collect();
            assert_close("sums", &wide, a, Tolerance::new(1e-5 * scale(&wide), 1e-5));
        }
        // A second run gives the same bits.
        assert!(run(&gpu, &case, &splats, [40, 12], shape, blocks * block * u64::from(MODEL.lights)) == cut);
    }
}

type Change<'a> = &'a dyn Fn(&mut Lit, &mut Vec<Splat>);

#[test]
fn radiance_and_gradients_match_reference_at_extremes() {
    let gpu = Gpu::new();
    let row = MODEL.row() as usize;
    let all = |c: &mut Lit, at: usize, v: f64| c.raw.lobes.chunks_mut(row).for_each(|r| r[at] = narrow(v));
    let changes: [(&str, Change); 8] = [
        ("roughness 0.01", &|c, _| c.pixels.iter_mut().for_each(|p| p.material.roughness = narrow(0.01))),
        ("sharp lobes", &|c, _| all(c, 3, 1e4_f64.ln())),
        ("blunt lobes", &|c, _| all(c, 3, 1e-3_f64.ln())),
        ("fierce lights", &|c, _| (4..7).for_each(|k| all(c, k, 1e6_f64.ln()))),
        ("faint lights", &|c, _| (4..7).for_each(|k| all(c, k, 1e-8_f64.ln()))),
        ("lights almost in the surface", &|c, _| {
            for (light, pixel) in [(0, 3), (1, 8), (3, 11)] {
                let p = c.pixels[pixel];
                (0..3).for_each(|k| c.raw.positions[3 * light + k] = narrow(p.point[k] + 1e-3 * p.normal[k]));
            }
        }),
        ("nothing gets through", &|_, s| s.iter_mut().for_each(|s| (s.opacity_logit, s.log_scale) = (9.0, [0.0; 3]))),
        ("nothing in the way", &|_, s| s.iter_mut().for_each(|s| s.opacity_logit = -14.0)),
    ];
    for (name, change) in changes {
        let mut case = Lit::random([9, 4], MODEL, true, 50);
        let mut splats = random_splats(80, 51);
        change(&mut case, &mut splats);
        eprintln!("{name}");
        let found = run(&gpu, &case, &splats, [9, 4], own(&gpu), 1 << 20);
        check_rays(&case, &splats, &found.seen);
        check(&case, &found, 1e-3);
    }
}

#[test]
fn traced_light_checks_can_fail() {
    let gpu = Gpu::new();
    let case = Lit::random([9, 4], MODEL, true, 60);
    let mut found = run(&gpu, &case, &random_splats(80, 61), [9, 4], own(&gpu), 1 << 20);
    check(&case, &found, 2e-4);
    let fails =
        |found: &Found| std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| check(&case, found, 2e-4))).is_err();
    // One ray has another visibility.
    let at = found.seen.iter().position(|s| *s > 0.2 && *s < 0.9).unwrap();
    found.seen[at] += 0.1;
    assert!(fails(&found));
    found.seen[at] -= 0.1;
    assert!(!fails(&found));
    let most =
        (0..found.positions.len()).max_by(|a, b| found.positions[*a].abs().total_cmp(&found.positions[*b].abs()));
    found.positions[most.unwrap()] *= 1.01;
    assert!(fails(&found));
    let plain: Vec<f64> = vec![0.0; found.direct.len()];
    assert!(worst(&plain, &found.direct, Tolerance::new(1e-7, 1e-5)).unwrap().3 > 1.0);
}

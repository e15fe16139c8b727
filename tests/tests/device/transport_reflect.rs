//! Reflections of surfels and patches against their reference.

use sgs_engine::graph::Graph;
use sgs_passes::reference::brdf::{V3, along, dot, unit};
use sgs_passes::reference::lights::Pixel;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport_reflect::{Reflected, Room};
use sgs_passes::reference::transport_shade::{Incoming, View, shade};
use sgs_passes::shade::environment::split_sum;
use sgs_passes::shade::lights::{Axes, LightModel};
use sgs_passes::transport::{
    AreaLights, Enclosure, ReflectionRays, ShadeTerms, SurfelTree, Surfels, TransportShading, reflection_bytes,
    split_sum_table, transport_reflect, transport_shade,
};
use sgs_tests::lit::{Lit, narrow};
use sgs_tests::transport::{bounds, bytes, discs, flat, random_surfels, random_values};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};
use std::f64::consts::PI;

/// Columns of views; buffers have a row to spare.
const COLUMNS: usize = 17;
const ROWS: usize = 12;
const PIXELS: usize = COLUMNS * ROWS;
const SPACE: usize = PIXELS + COLUMNS;
/// Distance of ray origins above surfaces, and depth in which discs count; exact in 32 bits.
const OFFSET: f64 = 0.015625;
const WINDOW: f64 = 0.125;

struct Case {
    lit: Lit,
    surfels: Surfels,
    enclosure: Enclosure,
    radiosity: Vec<V3>,
    irradiance: Vec<V3>,
    rays: u32,
}

impl Case {
    fn random(count: usize, rays: u32, seed: u32) -> Case {
        let model = LightModel { lights: 1, lobes: 1, axes: Axes::default() };
        let mut lit = Lit::random([COLUMNS, ROWS], model, true, seed);
        // Mirrors, glossy and rough surfaces; surfaces that face the camera.
        for (i, p) in lit.pixels.iter_mut().enumerate() {
            p.material.roughness = narrow([0.0, 0.05, 0.15, 0.3, 0.45, 0.55, 0.7, 1.0][i % 8]);
            if dot(p.normal, along(lit.camera, -1.0, p.point)) < 0.0 {
                p.normal = p.normal.map(|x| -x);
            }
        }
        lit.pixels[4].coverage = 0.0;
        lit.pixels[9].normal = [0.0; 3];
        let (surfels, enclosure) =
            (random_surfels(count, seed + 1), Enclosure::new([-1.5; 3], [1.5, 2.0, 2.5], 0.5).unwrap());
        let mut rng = Pcg::new(seed + 2);
        let radiosity = random_values(count + enclosure.patch_count() as usize, [0.0, 2.0], &mut rng);
        let irradiance = random_values(PIXELS, [0.0, 6.0], &mut rng);
        Case { lit, surfels, enclosure, radiosity, irradiance, rays }
    }

    fn room(&self) -> Room {
        Room {
            discs: discs(&self.surfels),
            bounds: bounds(&self.enclosure),
            radiosity: self.radiosity.clone(),
            offset: OFFSET,
            window: WINDOW,
            seed: 7,
            rays: self.rays,
            mirror: narrow(0.1),
            fade: narrow(0.5),
            diffuse: narrow(0.625),
        }
    }

    fn expected(&self) -> Vec<Reflected> {
        let room = self.room();
        let of = |(i, (p, e)): (usize, (_, &V3))| room.reflect(self.lit.camera, p, i as u32, *e);
        self.lit.pixels.iter().zip(&self.irradiance).enumerate().map(of).collect()
    }

    /// Returns reflected radiance and number of rays, and the indirect term of shading.
    fn run(&self, gpu: &Gpu) -> [Vec<f32>; 2] {
        let mut g = Graph::new("transport_reflect");
        let mut bound = self.lit.bind(&mut g, [COLUMNS as u32, ROWS as u32 + 1]);
        let tree = SurfelTree::new(&self.surfels).unwrap();
        let handles = tree.declare(&mut g);
        bound.inputs.extend(tree.contents(&handles));
        let radiosity = g.input("radiosity", 12 * self.radiosity.len() as u64);
        bound.inputs.push((radiosity, bytes(&flat(&self.radiosity).iter().map(|x| *x as f32).collect::<Vec<_>>())));
        let irradiance = g.external("irradiance", reflection_bytes(SPACE as u64));
        // What follows stays poisoned.
        let four = |e: &V3| [e[0] as f32, e[1] as f32, e[2] as f32, 1.0];
        bound.inputs.push((irradiance, bytes(&self.irradiance.iter().flat_map(four).collect::<Vec<f32>>())));
        let room = self.room();
        let rays = ReflectionRays {
            tree: handles,
            enclosure: self.enclosure,
            surfels: self.surfels.len() as u32,
            radiosity,
            offset: OFFSET as f32,
            window: WINDOW as f32,
            seed: room.seed,
            rays: room.rays,
            mirror: room.mirror as f32,
            fade: room.fade as f32,
            diffuse: room.diffuse as f32,
        };
        transport_reflect(&mut g, &gpu.tuning(), &bound.pixels, &rays, irradiance).unwrap();
        let lights = AreaLights::declare(&mut g, 0);
        let (split_sum, table) = split_sum_table(&mut g);
        bound.inputs.push((split_sum, table));
        let unit = g.input("unit", 4);
        let shading = TransportShading {
            pixels: bound.pixels,
            lights,
            unit,
            irradiance,
            reflections: true,
            emission: None,
            split_sum,
        };
        let [radiance, diffuse, specular, indirect, emission] =
            ["radiance", "diffuse", "specular", "indirect", "emission"].map(|n| g.external(n, 12 * SPACE as u64));
        let terms = ShadeTerms { diffuse, specular, indirect, emission };
        transport_shade(&mut g, gpu.tuning(), &shading, radiance, Some(&terms)).unwrap();
        let out = gpu.run(g, &bound.inputs);
        let all: Vec<f32> = out.get(irradiance);
        let read: Vec<f32> = self.irradiance.iter().flat_map(four).collect();
        assert_eq!(bytes(&all[..4 * PIXELS]), bytes(&read), "the gathered irradiance changed");
        let untouched = |values: &[f32]| values.iter().all(|x| x.to_bits() == u32::MAX);
        assert!(untouched(&all[4 * PIXELS..4 * SPACE]) && untouched(&all[4 * (SPACE + PIXELS)..]));
        let indirect: Vec<f32> = out.get(indirect);
        assert!(untouched(&indirect[3 * PIXELS..]));
        [all[4 * SPACE..4 * (SPACE + PIXELS)].to_vec(), indirect[..3 * PIXELS].to_vec()]
    }

    /// Returns the indirect term of shading without reflections.
    fn indirect(&self, irradiance: &[V3]) -> Vec<V3> {
        let table = split_sum::table();
        let view = View { camera: self.lit.camera, lights: &[], colors: &[], split_sum: &table };
        let none = Incoming { unit: vec![], irradiance: [0.0; 3], gain: 1.0, emission: [0.0; 3] };
        let of = |(p, e): (&Pixel, &V3)| shade(&view, p, &Incoming { irradiance: *e, ..none.clone() }).indirect;
        self.lit.pixels.iter().zip(irradiance).map(of).collect()
    }

    /// Compares pixels that rounding does not decide. Returns how many trace rays.
    fn check(&self, gpu: &Gpu, most_unsure: usize) -> usize {
        let ([found, indirect], expected) = (self.run(gpu), self.expected());
        let sure = || expected.iter().enumerate().filter(|(_, r)| !r.unsure);
        let unsure = PIXELS - sure().count();
        assert!(unsure <= most_unsure, "{unsure}");
        let is: Vec<f32> = sure().flat_map(|(i, _)| found[4 * i..4 * i + 4].to_vec()).collect();
        let four = |r: &Reflected| [r.radiance[0], r.radiance[1], r.radiance[2], f64::from(r.rays)];
        let mut right: Vec<f64> = sure().flat_map(|(_, r)| four(r)).collect();
        let tolerance = Tolerance::new(1e-6, 2e-3);
        assert_close("reflected radiance", &right, &is, tolerance);
        assert!(found.iter().all(|x| x.is_finite()));
        // Shading: k_d times the irradiance over pi, k_s times the reflected radiance.
        let reflected: Vec<V3> = found.chunks(4).map(|c| [c[0], c[1], c[2]].map(|x| PI * f64::from(x))).collect();
        let mut shaded = self.indirect(&reflected);
        for (i, p) in self.lit.pixels.iter().enumerate().filter(|(_, p)| p.coverage > 0.0 && p.normal != [0.0; 3]) {
            let matte = |c: usize| (1.0 - p.material.metallic) * p.material.albedo[c] / PI;
            (0..3).for_each(|c| shaded[i][c] += matte(c) * (self.irradiance[i][c] - reflected[i][c]));
        }
        let largest = flat(&shaded).iter().filter(|x| x.is_finite()).fold(0.0_f64, |a, b| a.max(b.abs()));
        // The table has no entry of a roughness that is not a number.
        let real = |k: usize| {
            let p = &self.lit.pixels[k / 3];
            !p.material.roughness.is_nan() && p.point.iter().chain(&p.normal).all(|x| x.is_finite())
        };
        for (k, (right, is)) in flat(&shaded).iter().zip(&indirect).enumerate().filter(|(k, _)| real(*k)) {
            assert!((right - f64::from(*is)).abs() <= 1e-4 * right.abs() + 1e-6 * largest, "{k}: {right} {is}");
        }
        // An error of a percent is caught.
        right.iter_mut().for_each(|x| *x *= 1.01);
        assert!(worst(&right, &is, tolerance).unwrap().3 > 1.0);
        sure().filter(|(_, r)| r.rays > 0).count()
    }
}

#[test]
fn reflections_match_reference() {
    let gpu = Gpu::new();
    for (count, rays, seed, unsure) in [(0, 8, 1, 12), (1, 1, 2, 12), (60, 8, 3, 40), (400, 3, 4, 60)] {
        let case = Case::random(count, rays, seed);
        let traced = case.check(&gpu, unsure);
        // Six in eight pixels are smooth enough.
        assert!(traced > PIXELS / 2 && traced <= PIXELS * 6 / 8, "{traced}");
        assert_eq!(case.run(&gpu).map(|v| bytes(&v)), case.run(&gpu).map(|v| bytes(&v)), "runs differ");
    }
}

#[test]
fn mirrors_show_the_wall_that_the_mirrored_ray_meets() {
    let gpu = Gpu::new();
    let mut case = Case::random(0, 8, 5);
    let colors: [V3; 6] =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]];
    case.radiosity = case.enclosure.patches().iter().map(|p| colors[p.face as usize]).collect();
    case.lit.pixels.iter_mut().for_each(|p| (p.material.roughness, p.coverage) = (0.02, 1.0));
    let [found, _] = case.run(&gpu);
    let (low, high) = (case.enclosure.low(), case.enclosure.high());
    let mut shown = [0; 6];
    for (i, p) in case.lit.pixels.iter().enumerate().filter(|(_, p)| p.normal != [0.0; 3]) {
        let v = unit(along(case.lit.camera, -1.0, p.point));
        let facing = dot(p.normal, v);
        if facing < 0.02 {
            continue;
        }
        let l = along(v.map(|x| -x), 2.0 * facing, p.normal);
        let from = along(p.point, OFFSET, p.normal);
        let reach: [f64; 3] =
            std::array::from_fn(|k| (f64::from(if l[k] > 0.0 { high[k] } else { low[k] }) - from[k]) / l[k]);
        let axis = (0..3).min_by(|a, b| reach[*a].total_cmp(&reach[*b])).unwrap();
        if (0..3).any(|k| k != axis && reach[k] - reach[axis] < 1e-4) {
            continue;
        }
        let face = 2 * axis + usize::from(l[axis] > 0.0);
        // The shares of a bilinear interpolation add up to one but for rounding, which devices may do differently.
        let bound = f64::from(f32::EPSILON) * (gpu.division_error() - 1.0);
        for (found, color) in found[4 * i..][..3].iter().zip(colors[face]) {
            assert!((f64::from(*found) - color).abs() <= bound, "pixel {i}: {found} instead of {color}");
        }
        assert_eq!(found[4 * i + 3], 1.0);
        shown[face] += 1;
    }
    assert!(shown.iter().all(|n| *n > 0), "{shown:?}");
}

/// Tests that all surfaces reflect their hemispherical albedo times the radiance.
#[test]
fn constant_radiance_is_reflected_at_every_roughness() {
    let gpu = Gpu::new();
    let radiance = [0.25, 1.0, 3.0];
    for count in [0, 300] {
        let mut case = Case::random(count, 8, 6);
        case.radiosity.fill(radiance);
        case.irradiance.fill(radiance.map(|l| narrow(PI * l)));
        for (i, p) in case.lit.pixels.iter_mut().enumerate() {
            p.material.roughness = narrow(i as f64 / (PIXELS - 1) as f64);
        }
        let ([found, indirect], expected) = (case.run(&gpu), case.indirect(&case.irradiance));
        for (i, p) in case.lit.pixels.iter().enumerate() {
            let nothing = p.coverage == 0.0 || p.normal == [0.0; 3];
            for k in 0..3 {
                let right = if nothing { 0.0 } else { radiance[k] };
                let off = (f64::from(found[4 * i + k]) - right).abs();
                assert!(off <= 1e-6 * right, "pixel {i}: {:?}", &found[4 * i..4 * i + 4]);
            }
        }
        assert_close("indirect light", &flat(&expected), &indirect, Tolerance::new(1e-6, 2e-5));
    }
}

#[test]
fn extreme_pixels_match_reference() {
    let gpu = Gpu::new();
    let mut case = Case::random(200, 8, 8);
    let camera = case.lit.camera;
    for (i, p) in case.lit.pixels.iter_mut().enumerate() {
        match i % 10 {
            0 => p.material.roughness = f64::NAN,
            1 => p.material.roughness = f64::INFINITY,
            2 => p.point[1] = f64::NAN,
            3 => p.point[2] = f64::INFINITY,
            4 => p.normal[0] = f64::NAN,
            // Seen from behind, edge-on, and from the point itself.
            5 => p.normal = unit(along(p.point, -1.0, camera)).map(narrow),
            6 => {
                let v = unit(along(camera, -1.0, p.point));
                p.normal = unit([v[1], -v[0], 0.0]).map(narrow);
            }
            7 => p.point = camera,
            8 => p.material.roughness = -0.5,
            _ => p.point = [40.0, -30.0, 0.5],
        }
    }
    case.check(&gpu, 90);
    // No light, bright light, and one patch per face.
    for (scale, cell) in [(0.0, 0.5), (1e30, 0.5), (1.0, 10.0)] {
        let mut case = Case::random(100, 8, 10);
        case.enclosure = Enclosure::new([-1.5; 3], [1.5; 3], cell).unwrap();
        let count = case.surfels.len() + case.enclosure.patch_count() as usize;
        case.radiosity =
            random_values(count, [0.0, 1.0], &mut Pcg::new(3)).iter().map(|b| b.map(|x| narrow(scale * x))).collect();
        case.irradiance.iter_mut().for_each(|e| *e = e.map(|x| narrow(scale * x)));
        let found = case.run(&gpu)[0].clone();
        assert!(
            found.iter().all(|x| x.is_finite()) && (scale > 0.0 || found.iter().skip(3).step_by(4).any(|n| *n > 0.0))
        );
        if scale > 0.0 {
            case.check(&gpu, 60);
        }
    }
}

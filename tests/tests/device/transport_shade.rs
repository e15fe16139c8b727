//! Shading by physical lights and gathered irradiance against its reference.
//!
//! Gradients are tested against finite differences.

use sgs_engine::graph::Graph;
use sgs_passes::reference::area_lights::Light;
use sgs_passes::reference::brdf::{V3, unit};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport_shade::{Incoming, Terms, View, shade};
use sgs_passes::shade::environment::split_sum;
use sgs_passes::shade::lights::{Axes, LightModel};
use sgs_passes::transport::{
    AreaLight, AreaLights, LightShape, ShadeGradients, ShadeTerms, TransportShading, split_sum_table, transport_shade,
    transport_shade_bwd,
};
use sgs_tests::area_lights::{light, one_of_each};
use sgs_tests::lit::{BEFORE, Lit, narrow};
use sgs_tests::{Gpu, Tolerance, assert_close, finite_difference, worst};

/// Columns of views; buffers have a row to spare.
const COLUMNS: usize = 7;
const ROWS: usize = 5;
const SIZE: [usize; 2] = [COLUMNS, ROWS];
const PIXELS: usize = COLUMNS * ROWS;
const ROOM: usize = PIXELS + COLUMNS;

struct Case {
    lit: Lit,
    lights: Vec<AreaLight>,
    incoming: Vec<Incoming>,
    emission: bool,
}

struct Found {
    radiance: Vec<f32>,
    /// Diffuse, specular, indirect, emission.
    terms: [Vec<f32>; 4],
    materials: Vec<f32>,
    metallic: Vec<f32>,
    irradiance: Vec<f32>,
    emission: Vec<f32>,
    colors: Vec<f32>,
}

fn bytes(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(|x| (x as f32).to_le_bytes()).collect()
}

/// Returns the part of a buffer of the view's pixels; the rest must be unwritten.
fn cut(values: Vec<f32>, width: usize) -> Vec<f32> {
    assert!(
        values[width * PIXELS..].iter().all(|x| x.to_bits() == u32::MAX),
        "a pixel outside of the view was written"
    );
    values[..width * PIXELS].to_vec()
}

impl Case {
    fn random(lights: Vec<AreaLight>, metallic: bool, emission: bool, seed: u32) -> Case {
        let mut lit = Lit::random(SIZE, LightModel { lights: 1, lobes: 1, axes: Axes::default() }, metallic, seed);
        lit.pixels[4].coverage = 0.0;
        lit.pixels[9].normal = [0.0; 3];
        let mut rng = Pcg::new(seed + 2000);
        let mut color = |high: f64| [0; 3].map(|_| narrow(rng.range(0.0, high)));
        let incoming = (0..PIXELS)
            .map(|_| {
                let unit = lights.iter().map(|_| color(2.0)).map(|c| if c[1] < 0.4 { 0.0 } else { c[0] }).collect();
                let gain = 0.5 + color(1.0)[0];
                Incoming { unit, irradiance: color(3.0), gain, emission: if emission { color(0.5) } else { [0.0; 3] } }
            })
            .collect();
        Case { lit, lights, incoming, emission }
    }

    fn run(&self, gpu: &Gpu) -> Found {
        let mut g = Graph::new("transport_shade");
        let mut bound = self.lit.bind(&mut g, [COLUMNS as u32, ROWS as u32 + 1]);
        let lights = AreaLights::declare(&mut g, self.lights.len() as u32);
        if !self.lights.is_empty() {
            bound.inputs.extend(lights.contents(&self.lights));
        }
        let mut input = |g: &mut Graph, name: &str, data: Vec<u8>, room: usize| {
            let buffer = g.input(name, room as u64);
            bound.inputs.push((buffer, data));
            buffer
        };
        let four = |c: V3, last: f64| [c[0], c[1], c[2], last];
        let by_light = |l: usize| {
            let row = self.incoming.iter().map(move |p| p.unit[l]);
            row.chain(std::iter::repeat_n(f64::NAN, ROOM - PIXELS))
        };
        let unit = bytes((0..self.lights.len()).flat_map(by_light));
        let unit = input(&mut g, "unit", unit, 4 * ROOM * self.lights.len().max(1));
        let irradiance = bytes(self.incoming.iter().flat_map(|p| four(p.irradiance, p.gain)));
        let irradiance = input(&mut g, "irradiance", irradiance, 16 * ROOM);
        let emission = bytes(self.incoming.iter().flat_map(|p| four(p.emission, f64::NAN)));
        let emission = self.emission.then(|| input(&mut g, "emission", emission, 16 * ROOM));
        // Gradients of materials are added to.
        let mut begun = |g: &mut Graph, name: &str, width: usize| {
            let buffer = g.external(name, (4 * width * ROOM) as u64);
            bound.inputs.push((buffer, bytes(vec![f64::from(BEFORE); width * PIXELS])));
            buffer
        };
        let materials = begun(&mut g, "materials_gradient", 4);
        let metallic = begun(&mut g, "metallic_gradient", 1);
        let (split_sum, table) = split_sum_table(&mut g);
        bound.inputs.push((split_sum, table));
        let what = TransportShading {
            pixels: bound.pixels,
            lights,
            unit,
            irradiance,
            reflections: false,
            emission,
            split_sum,
        };
        let room = 4 * ROOM as u64;
        let [radiance, plain] = ["radiance", "plain"].map(|name| g.external(name, 3 * room));
        let [diffuse, specular, indirect, emitted] =
            ["diffuse", "specular", "indirect", "emitted"].map(|name| g.external(name, 3 * room));
        let terms = ShadeTerms { diffuse, specular, indirect, emission: emitted };
        transport_shade(&mut g, gpu.tuning(), &what, radiance, Some(&terms)).unwrap();
        transport_shade(&mut g, gpu.tuning(), &what, plain, None).unwrap();
        let into = ShadeGradients {
            materials,
            metallic: self.lit.metallic.then_some(metallic),
            irradiance: g.external("irradiance_gradient", 4 * room),
            emission: self.emission.then(|| g.external("emission_gradient", 4 * room)),
            colors: g.external("colors_gradient", 12 * self.lights.len().max(1) as u64),
        };
        transport_shade_bwd(&mut g, gpu.tuning(), &what, bound.gradient, &into).unwrap();
        let out = gpu.run(g, &bound.inputs);
        let radiance = cut(out.get(radiance), 3);
        assert_eq!(radiance, cut(out.get(plain), 3), "terms change the radiance");
        let emission_gradient = into.emission.map_or_else(Vec::new, |buffer| cut(out.get(buffer), 4));
        Found {
            radiance,
            terms: [diffuse, specular, indirect, emitted].map(|buffer| cut(out.get(buffer), 3)),
            materials: cut(out.get(materials), 4),
            metallic: cut(out.get(metallic), 1),
            irradiance: cut(out.get(into.irradiance), 4),
            emission: emission_gradient,
            colors: out.get(into.colors),
        }
    }

    fn expected(&self, split_sum: &[[f32; 2]]) -> Vec<Terms> {
        let lights: Vec<Light> = self.lights.iter().map(|l| Light::new(&l.record())).collect();
        let colors: Vec<V3> = self.lights.iter().map(|l| l.color.map(f64::from)).collect();
        let view = View { camera: self.lit.camera, lights: &lights, colors: &colors, split_sum };
        self.lit.pixels.iter().zip(&self.incoming).map(|(p, i)| shade(&view, p, i)).collect()
    }

    /// Returns the loss of one pixel at other parameters: albedo, roughness, metallic, irradiance, gain, emission, then colors.
    fn loss(&self, view: &View<'_>, i: usize, x: &[f64]) -> f64 {
        let mut pixel = self.lit.pixels[i];
        pixel.material.albedo = [x[0], x[1], x[2]];
        (pixel.material.roughness, pixel.material.metallic) = (x[3], x[4]);
        let incoming = Incoming {
            unit: self.incoming[i].unit.clone(),
            irradiance: [x[5], x[6], x[7]],
            gain: x[8],
            emission: [x[9], x[10], x[11]],
        };
        let colors: Vec<V3> = x[12..].chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let radiance = shade(&View { colors: &colors, ..*view }, &pixel, &incoming).radiance();
        (0..3).map(|k| self.lit.gradient[3 * i + k] * radiance[k]).sum()
    }

    fn check(&self, gpu: &Gpu, tolerance: f64) -> Found {
        let table = split_sum::table();
        let (found, expected) = (self.run(gpu), self.expected(&table));
        let close = |what: &str, right: Vec<f64>, is: &[f32]| {
            let largest = right.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            assert_close(what, &right, is, Tolerance::new(1e-6 * largest.min(1.0), tolerance));
        };
        close("radiance", expected.iter().flat_map(Terms::radiance).collect(), &found.radiance);
        close("diffuse", expected.iter().flat_map(|t| t.diffuse).collect(), &found.terms[0]);
        close("specular", expected.iter().flat_map(|t| t.specular).collect(), &found.terms[1]);
        close("indirect", expected.iter().flat_map(|t| t.indirect).collect(), &found.terms[2]);
        close("emission", expected.iter().flat_map(|t| t.emission).collect(), &found.terms[3]);
        found
    }

    /// Checks every gradient against central differences.
    fn check_gradients(&self, found: &Found, tolerance: f64) {
        let table = split_sum::table();
        let lights: Vec<Light> = self.lights.iter().map(|l| Light::new(&l.record())).collect();
        let view = View { camera: self.lit.camera, lights: &lights, colors: &[], split_sum: &table };
        let mut colors = vec![0.0; 3 * lights.len()];
        let mut sizes = colors.clone();
        for (i, p) in self.lit.pixels.iter().enumerate() {
            let (m, incoming) = (p.material, &self.incoming[i]);
            let mut x: Vec<f64> =
                [&m.albedo[..], &[m.roughness, m.metallic], &incoming.irradiance, &[incoming.gain], &incoming.emission]
                    .concat();
            x.extend(self.lights.iter().flat_map(|l| l.color.map(f64::from)));
            for k in 0..x.len() {
                let slope = finite_difference(&mut x, k, 1e-6, |x| self.loss(&view, i, x));
                let is = match k {
                    0..4 => found.materials[4 * i + k] - BEFORE,
                    4 if self.lit.metallic => found.metallic[i] - BEFORE,
                    4 => {
                        assert_eq!(found.metallic[i], BEFORE);
                        continue;
                    }
                    5..9 => found.irradiance[4 * i + k - 5],
                    9..12 if self.emission => found.emission[4 * i + k - 9],
                    9..12 => continue,
                    _ => {
                        colors[k - 12] += slope;
                        sizes[k - 12] += slope.abs();
                        continue;
                    }
                };
                let bound = tolerance * (slope.abs() + 0.05);
                assert!((slope - f64::from(is)).abs() < bound, "pixel {i} {p:?}, {k}: {slope} {is}");
            }
        }
        for (k, (slope, size)) in colors.iter().zip(&sizes).enumerate() {
            let is = f64::from(found.colors[k]);
            assert!((slope - is).abs() <= tolerance * size, "color {k}: {slope} {is}");
        }
    }
}

fn colored(mut lights: Vec<AreaLight>, rng: &mut Pcg) -> Vec<AreaLight> {
    lights.iter_mut().for_each(|l| l.color = [0; 3].map(|_| rng.range(0.0, 4.0) as f32));
    lights
}

#[test]
fn radiance_and_gradients_match_reference() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(3);
    for (seed, metallic, emission, size) in
        [(1, true, true, 1.0), (2, false, false, 0.2), (3, true, false, 4.0), (4, false, true, 0.01)]
    {
        let mut lights = colored(one_of_each(&mut rng, 2.5, size), &mut rng);
        lights[2].color = [0.0; 3];
        let case = Case::random(lights, metallic, emission, seed);
        let found = case.check(&gpu, 2e-4);
        case.check_gradients(&found, 1e-3);
        // Pixels without a surface or a normal are black.
        for i in [4, 9] {
            assert_eq!(found.radiance[3 * i..3 * i + 3], [0.0; 3]);
            assert_eq!(found.materials[4 * i..4 * i + 4], [BEFORE; 4]);
        }
        // An error of a percent in one light is caught.
        let mut wrong = case.expected(&split_sum::table());
        wrong.iter_mut().for_each(|t| t.specular = t.specular.map(|x| 1.01 * x));
        let wrong: Vec<f64> = wrong.iter().flat_map(|t| t.specular).collect();
        assert!(worst(&wrong, &found.terms[1], Tolerance::new(1e-6, 2e-4)).unwrap().3 > 1.0);
    }
}

#[test]
fn many_lights_and_no_lights_match_reference() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(5);
    let many = (0..9).flat_map(|_| one_of_each(&mut rng, 3.0, 0.5)).collect();
    let mut rng = Pcg::new(6);
    let case = Case::random(colored(many, &mut rng), true, true, 8);
    let found = case.check(&gpu, 2e-4);
    case.check_gradients(&found, 1e-3);
    let case = Case::random(vec![], true, true, 9);
    let found = case.check(&gpu, 2e-4);
    case.check_gradients(&found, 1e-3);
    assert!(found.colors.iter().all(|x| x.to_bits() == u32::MAX));
}

/// Tests lights in the surface and behind it, and points inside of a sphere.
///
/// Also grazing and hidden cameras, the ends of all materials, and bright lights.
#[test]
fn extreme_surfaces_match_reference() {
    let gpu = Gpu::new();
    let lights = [
        LightShape::Point { position: [0.0, 0.0, 0.0] },
        LightShape::Sphere { center: [0.0, 0.0, 0.5], radius: 1.0 },
        LightShape::Sphere { center: [30.0, 0.0, 40.0], radius: 1e-3 },
        LightShape::Rectangle { corner: [-1.0, -1.0, 0.0], edge_u: [2.0, 0.0, 0.0], edge_v: [0.0, 2.0, 0.0] },
        LightShape::Rectangle { corner: [-500.0, -500.0, 2.0], edge_u: [0.0, 1e3, 0.0], edge_v: [1e3, 0.0, 0.0] },
        LightShape::Disk { center: [0.0, 0.0, 1e4], normal: [0.0, 0.0, -1.0], radius: 1e4 },
        LightShape::Disk { center: [0.0, 0.0, -1.0], normal: [0.0, 0.0, 1.0], radius: 0.25 },
        LightShape::Directional { direction: [0.0, 0.0, -1.0], angular_radius: 1.57 },
        LightShape::Directional { direction: [1.0, 0.0, -0.001], angular_radius: 0.0 },
        LightShape::Lobe { position: [0.0, 0.0, 0.0], axis: [0.0, 0.0, 1.0], sharpness: 1e4 },
    ]
    .map(light);
    let mut bright = lights;
    bright.iter_mut().for_each(|l| l.color = [1e6, 1.0, 0.0]);
    let mut case = Case::random(bright.to_vec(), true, true, 21);
    let points = [[0.0, 0.0, 0.0], [0.5, 0.25, 0.0], [0.0, 0.0, 1.0], [3.0, 0.0, 0.0], [0.25, -0.5, 0.75]];
    let normals = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]].map(|n| unit(n).map(narrow));
    for camera in [[0.0, 0.0, 8.0], [0.0, 4.0, 0.0], [0.3, 0.2, -5.0]] {
        case.lit.camera = camera.map(narrow);
        for (i, p) in case.lit.pixels.iter_mut().enumerate() {
            (p.point, p.normal) = (points[i % 5].map(narrow), normals[i % 4]);
            p.material.albedo = [[0.0; 3], [1.0; 3], [0.5, 0.0, 1.0]][i % 3].map(narrow);
            p.material.roughness = narrow([0.03, 0.2, 1.0, 0.0, 0.6][i / 7 % 5]);
            p.material.metallic = [0.0, 1.0, 0.5][i / 2 % 3];
        }
        let found = case.check(&gpu, 2e-2);
        let all =
            [&found.radiance, &found.materials, &found.metallic, &found.irradiance, &found.emission, &found.colors];
        assert!(all.iter().all(|v| v.iter().all(|x| x.is_finite())));
    }
}

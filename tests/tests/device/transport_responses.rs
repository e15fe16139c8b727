//! Sums of responses and emission of Gaussians against their references.

use sgs_engine::graph::Graph;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{
    V3, gaussian_emission as emission, response_radiosity as radiosity, response_source as source, response_sum as sum,
};
use sgs_passes::transport::{
    DirectLight, GaussianEmitters, ResponseRadiosity, ResponseSource, Responses, gaussian_emission, response_radiosity,
    response_source, response_store, response_sum,
};
use sgs_tests::transport::{bytes, flat, random_values};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

/// Returns single-precision values as bytes, at least four.
fn single(values: &[V3]) -> Vec<u8> {
    let all = bytes(&flat(values).iter().map(|x| *x as f32).collect::<Vec<_>>());
    if all.is_empty() { vec![0; 4] } else { all }
}

fn run_sum(gpu: &Gpu, responses: &[Vec<V3>], colors: &[V3], receivers: usize) -> Vec<f32> {
    let mut g = Graph::new("response_sum");
    let (all, of_colors) = (single(&responses.concat()), single(colors));
    let a = Responses {
        lights: colors.len() as u32,
        receivers: receivers as u32,
        responses: g.input("responses", all.len() as u64),
        colors: g.input("colors", of_colors.len() as u64),
    };
    let irradiance = g.external("irradiance", 12 * receivers as u64);
    response_sum(&mut g, &gpu.tuning(), &a, irradiance).unwrap();
    gpu.run(g, &[(a.responses, all), (a.colors, of_colors)]).get(irradiance)
}

fn run_emission(gpu: &Gpu, numbers: &[u32], radiance: &[V3]) -> Vec<f32> {
    let mut g = Graph::new("gaussian_emission");
    let of_radiance = single(radiance);
    let a = GaussianEmitters {
        gaussians: numbers.len() as u32,
        emitters: radiance.len() as u32,
        numbers: g.input("numbers", 4 * numbers.len() as u64),
        radiance: g.input("radiance", of_radiance.len() as u64),
    };
    let values = g.external("values", 16 * numbers.len() as u64);
    gaussian_emission(&mut g, &gpu.tuning(), &a, values).unwrap();
    gpu.run(g, &[(a.numbers, bytes(numbers)), (a.radiance, of_radiance)]).get(values)
}

fn random(lights: usize, receivers: usize, most: f64, seed: u32) -> (Vec<Vec<V3>>, Vec<V3>) {
    let mut rng = Pcg::new(seed);
    let responses = (0..lights).map(|_| random_values(receivers, [0.0, most], &mut rng)).collect();
    (responses, random_values(lights, [0.0, 5.0], &mut rng))
}

#[test]
fn sums_match_reference() {
    let gpu = Gpu::new();
    for (lights, receivers) in [(0, 3), (1, 1), (2, 255), (7, 256), (12, 257), (40, 1000)] {
        let (responses, mut colors) = random(lights, receivers, 3.0, 5);
        if lights > 2 {
            // Off, and without one channel.
            (colors[1], colors[2][0]) = ([0.0; 3], 0.0);
        }
        let found = run_sum(&gpu, &responses, &colors, receivers);
        let expected = flat(&sum(&responses, &colors, receivers));
        let tolerance = Tolerance::new(1e-30, 1e-6 * lights.max(1) as f64);
        assert_close("irradiance", &expected, &found, tolerance);
        // The sum without an emitter that is on differs.
        if lights > 2 {
            colors[lights - 1] = [0.0; 3];
            let wrong = flat(&sum(&responses, &colors, receivers));
            assert!(worst(&wrong, &found, tolerance).unwrap().3 > 1.0);
        }
    }
}

#[test]
fn sums_of_extreme_responses_match_reference() {
    let gpu = Gpu::new();
    for most in [1e-30, 1e30] {
        let (responses, colors) = random(5, 100, most, 7);
        let expected = flat(&sum(&responses, &colors, 100));
        assert_close("irradiance", &expected, &run_sum(&gpu, &responses, &colors, 100), Tolerance::new(0.0, 1e-5));
    }
    // An emitter that is off adds nothing, whatever its response.
    let (mut responses, mut colors) = random(3, 100, 1.0, 9);
    (responses[1], colors[1]) = (vec![[f64::INFINITY, f64::NAN, -f64::INFINITY]; 100], [0.0; 3]);
    let expected = flat(&sum(&responses, &colors, 100));
    assert_close("irradiance", &expected, &run_sum(&gpu, &responses, &colors, 100), Tolerance::new(1e-30, 1e-5));
}

#[test]
fn emission_is_that_of_the_emitter() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(11);
    for (count, emitters) in [(1, 0), (1, 1), (256, 3), (1000, 9)] {
        let radiance = random_values(emitters, [0.0, 1e30], &mut rng);
        // Numbers beyond the last emitter emit nothing.
        let mut numbers: Vec<u32> = (0..count).map(|_| rng.next_u32() % (emitters as u32 + 3)).collect();
        numbers[count - 1] = u32::MAX;
        let found = run_emission(&gpu, &numbers, &radiance);
        let four = emission(&numbers, &radiance).into_iter().flat_map(|[r, g, b]| [r, g, b, 0.0]);
        let expected: Vec<f32> = four.map(|x| x as f32).collect();
        assert_eq!(found, expected);
        if emitters > 1 {
            numbers[0] = if numbers[0] == 1 { 2 } else { 1 };
            assert_ne!(run_emission(&gpu, &numbers, &radiance), expected, "a number changes the emission");
        }
    }
}

#[test]
fn source_is_reflected_direct_light() {
    let gpu = Gpu::new();
    for (count, most) in [(1, 2.0), (255, 2.0), (257, 1e-30), (1000, 1e30)] {
        let mut rng = Pcg::new(13);
        let reflectance = random_values(count, [0.0, 1.0], &mut rng);
        let unit: Vec<f64> = random_values(count, [0.0, most], &mut rng).iter().map(|v| v[0]).collect();
        let mut g = Graph::new("response_source");
        let a = ResponseSource {
            receivers: count as u32,
            unit: g.input("unit", 4 * count as u64),
            reflectance: g.input("reflectance", 12 * count as u64),
            source: g.external("source", 12 * count as u64),
        };
        response_source(&mut g, &gpu.tuning(), &a).unwrap();
        let of_unit = bytes(&unit.iter().map(|x| *x as f32).collect::<Vec<_>>());
        let found = gpu.run(g, &[(a.unit, of_unit), (a.reflectance, single(&reflectance))]).get(a.source);
        let mut expected = flat(&source(&unit, &reflectance));
        let tolerance = Tolerance::new(1e-38, 1e-6);
        assert_close("source", &expected, &found, tolerance);
        expected[0] *= 1.001;
        assert!(worst(&expected, &found, tolerance).unwrap().3 > 1.0);
    }
}

#[test]
fn radiosity_reflects_direct_and_bounced_light() {
    let gpu = Gpu::new();
    for (lights, count, most) in [(0, 3, 2.0), (1, 1, 2.0), (7, 257, 1e-30), (12, 1000, 1e30)] {
        let mut rng = Pcg::new(19);
        let [reflectance, irradiance] = [1.0, most].map(|most| random_values(count, [0.0, most], &mut rng));
        let mut colors = random_values(lights, [0.0, 5.0], &mut rng);
        let mut units: Vec<Vec<f64>> =
            (0..lights).map(|_| random_values(count, [0.0, most], &mut rng).iter().map(|v| v[0]).collect()).collect();
        if lights > 2 {
            // Off, whatever its light.
            (colors[1], units[1]) = ([0.0; 3], vec![f64::NAN; count]);
        }
        let mut g = Graph::new("response_radiosity");
        let three = 12 * count as u64;
        let (of_colors, of_units) =
            (single(&colors), bytes(&units.concat().iter().map(|x| *x as f32).collect::<Vec<_>>()));
        let a = ResponseRadiosity {
            lights: lights as u32,
            receivers: count as u32,
            unit: g.input("unit", of_units.len().max(4) as u64),
            colors: g.input("colors", of_colors.len() as u64),
            irradiance: g.input("irradiance", three),
            reflectance: g.input("reflectance", three),
            radiosity: g.external("radiosity", three),
        };
        response_radiosity(&mut g, &gpu.tuning(), &a).unwrap();
        let inputs = [
            (a.unit, of_units),
            (a.colors, of_colors),
            (a.irradiance, single(&irradiance)),
            (a.reflectance, single(&reflectance)),
        ];
        let found = gpu.run(g, &inputs).get(a.radiosity);
        let mut expected = flat(&radiosity(&units, &colors, &irradiance, &reflectance));
        let tolerance = Tolerance::new(1e-38, 1e-5);
        assert_close("radiosity", &expected, &found, tolerance);
        expected[0] *= 1.001;
        assert!(worst(&expected, &found, tolerance).unwrap().3 > 1.0);
    }
}

#[test]
fn responses_are_stored_in_their_place() {
    let gpu = Gpu::new();
    let (lights, receivers) = (4, 300);
    let (responses, _) = random(lights, receivers, 2.0, 15);
    let (new, _) = random(1, receivers, 2.0, 17);
    let units: Vec<f32> = (0..lights * receivers).map(|i| i as f32).collect();
    let unit: Vec<f32> = (0..receivers).map(|i| -1.0 - i as f32).collect();
    // The last index is that of no emitter.
    for (emitter, with_direct) in (0..=lights).flat_map(|e| [(e, false), (e, true)]) {
        let mut g = Graph::new("response_store");
        let colors = g.input("unused", 4);
        let all = g.external("responses", 12 * (lights * receivers) as u64);
        let a = Responses { lights: lights as u32, receivers: receivers as u32, responses: all, colors };
        let irradiance = g.input("irradiance", 12 * receivers as u64);
        let index = g.input("emitter", 4);
        let direct = DirectLight {
            unit: g.input("unit", 4 * receivers as u64),
            units: g.external("units", 4 * (lights * receivers) as u64),
        };
        response_store(&mut g, &gpu.tuning(), &a, index, irradiance, with_direct.then_some(&direct)).unwrap();
        let mut inputs =
            vec![(all, single(&responses.concat())), (irradiance, single(&new[0])), (index, bytes(&[emitter as u32]))];
        if with_direct {
            inputs.extend([(direct.unit, bytes(&unit)), (direct.units, bytes(&units))]);
        }
        let out = gpu.run(g, &inputs);
        let mut expected = responses.clone();
        let mut expected_units = units.clone();
        if emitter < lights {
            expected[emitter].clone_from(&new[0]);
            expected_units[emitter * receivers..(emitter + 1) * receivers].copy_from_slice(&unit);
        }
        assert_eq!(bytes(&out.get::<f32>(all)), single(&expected.concat()), "{emitter}");
        if with_direct {
            assert_eq!(out.get::<f32>(direct.units), expected_units, "{emitter}");
        }
    }
}

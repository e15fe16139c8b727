//! Regularization and pruning of lights against the reference.

use sgs_engine::graph::Graph;
use sgs_passes::reference::lights as reference;
use sgs_passes::shade::lights::{
    Axes, LightGradients, LightModel, LightParameterGradients, Lights, Shape, lights_prepare, lights_prepare_bwd,
    lights_regularize,
};
use sgs_tests::lit::Lit;
use sgs_tests::{Gpu, Tolerance, assert_close};

const SMALL: LightModel = LightModel { lights: 5, lobes: 12, axes: Axes::Grid };

/// Losses match the reference, and gradients match its differences.
///
/// Disabled lights have neither losses nor gradients.
#[test]
fn light_regularizers_match_reference() {
    let gpu = Gpu::new();
    let weights = [0.3_f32, 0.7];
    for (size, model, far) in [
        ([9, 5], SMALL, false),
        ([70, 41], LightModel { lights: 19, lobes: 3, axes: Axes::Free }, false),
        ([4, 2], SMALL, true),
    ] {
        let mut case = Lit::random(size, model, false, 31);
        case.pixels.iter_mut().step_by(3).for_each(|p| (p.coverage, p.point) = (0.0, [f64::NAN; 3]));
        case.raw.gains[1] = 0.0;
        case.raw.lobes[5] = 16.0;
        // One light lies at a surface point, another too near to one for a gradient.
        case.raw.positions[..3].copy_from_slice(&case.pixels[1].point);
        case.raw.positions[6..9].copy_from_slice(&case.pixels[2].point.map(|x| sgs_tests::lit::narrow(x + 0.01)));
        if far {
            case.pixels.iter_mut().for_each(|p| p.coverage = 0.0);
        }
        let own = Shape::for_device(gpu.tuning());
        for shape in [own, Shape { per_lane: 1, ..own }] {
            let mut g = Graph::new("regularizers");
            let bound = case.bind(&mut g, size.map(|s| s as u32 + 3));
            let (tuning, step) = (gpu.tuning(), bound.pixels.screen.step);
            let prepared =
                lights_prepare(&mut g, tuning, "lights_prepare", step, model, &bound.parameters, None).unwrap();
            let what = Lights { pixels: bound.pixels, prepared, normalizer: 1.0, shape };
            let losses = g.external("losses", 8);
            let regularizers = lights_regularize(&mut g, tuning, &what, &bound.parameters, weights, losses).unwrap();
            let sums = g.transient("sums", 32 * u64::from(model.lights * (1 + model.lobes)));
            g.fill("clear", sums, 0).unwrap();
            let into = LightParameterGradients {
                positions: g.external("positions_gradient", model.position_bytes()),
                lobes: g.external("lobes_gradient", model.lobe_bytes()),
            };
            let gradients = LightGradients { buffer: sums };
            lights_prepare_bwd(&mut g, &prepared, &bound.parameters, &gradients, Some(&regularizers), &into).unwrap();
            let out = gpu.run(g, &bound.inputs);
            let expected = reference::lights_regularize(&case.raw, &case.pixels);
            assert_close("losses", &expected, &out.get::<f32>(losses), Tolerance::new(0.0, 1e-5));
            assert_eq!(far, expected[0] == 0.0);
            let total = |raw: &reference::Raw| {
                let [near, bright] = reference::lights_regularize(raw, &case.pixels);
                f64::from(weights[0]) * near + f64::from(weights[1]) * bright
            };
            let mut raw = case.raw.clone();
            let mut slopes = |which: fn(&mut reference::Raw) -> &mut Vec<f64>| -> Vec<f64> {
                (0..which(&mut raw).len())
                    .map(|i| {
                        let x = which(&mut raw)[i];
                        let [up, down] = [1e-6, -1e-6].map(|h| {
                            which(&mut raw)[i] = x + h;
                            total(&raw)
                        });
                        which(&mut raw)[i] = x;
                        (up - down) / 2e-6
                    })
                    .collect()
            };
            let (places, lobes) = (slopes(|r| &mut r.positions), slopes(|r| &mut r.lobes));
            // One bright light dominates the sum, so differences have that light's rounding.
            let floor = 1e-9 * (1.0 + total(&case.raw));
            assert_close("places", &places, &out.get::<f32>(into.positions), Tolerance::new(floor, 1e-3));
            assert_close("lobes", &lobes, &out.get::<f32>(into.lobes), Tolerance::new(floor, 1e-3));
        }
    }
}

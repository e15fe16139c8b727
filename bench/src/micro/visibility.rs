//! Benchmark of the visibility field at its published size with 64 lights.
//!
//! Values are checked against the reference, gradients by an identity. A layer without bias is linear in its weights,
//! and a ReLU scales its input by 0 or 1. Weights times gradients therefore have the same sum in every layer. The sum
//! in the tables is that of the first layer's features.

use super::Context;
use crate::harness::{Rig, add_passes, bytes};
use crate::micro::lights::Lit;
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::Accuracy;
use sgs_passes::cost::Counts;
use sgs_passes::reference::visibility as reference;
use sgs_passes::shade::lights::LightModel;
use sgs_passes::shade::visibility::{
    BackwardOptions, Constant, FIELD_WIDTH, FieldConfig, Gradients, View, VisibilityField, visibility, visibility_adam,
    visibility_bwd,
};
use sgs_shaders::structs::FieldStep;

const LOW: [f32; 3] = [-1.6; 3];
const HIGH: [f32; 3] = [1.6; 3];

/// Measures values, gradients and an optimizer step.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let (size, model, config) = (c.workload.largest, LightModel::default(), FieldConfig::default());
    let lit = Lit::room(size, model);
    let n = lit.points.len();
    let mut g = Graph::new("visibility");
    let handles = VisibilityField::handles(&mut g, config, true, 32);
    let f = handles.field;
    let view = View {
        pixels: n as u32,
        points: g.input("points", 12 * n as u64),
        coverage: g.input("coverage", 4 * n as u64),
        lights: g.input("lights", 12 * u64::from(model.lights)),
    };
    let constant = Constant {
        radiance: g.input("radiance", 12 * u64::from(model.lights)),
        radiance_gradient: g.input("radiance_gradient", 12 * n as u64),
    };
    let [seen, plain] = ["seen", "plain"].map(|name| g.external(name, 4 * n as u64));
    visibility(&mut g, c.tuning, &f, &view, None, true, seen)?;
    visibility(&mut g, c.tuning, &f, &view, None, false, plain)?;
    // Separate pass if the device has cooperative matrices and this build has kernels for them.
    let halves = c.tuning.with(Accuracy { visibility_bits: 16, ..c.tuning.accuracy });
    let on_units = halves.field_matrices().map(|_| g.external("on_units", 4 * n as u64));
    if let Some(into) = on_units {
        visibility(&mut g, halves, &f, &view, None, true, into)?;
    }
    let gradients = handles.gradients(&mut g, model.lights);
    let gradients = gradients.ok_or_else(|| anyhow::anyhow!("The field is not declared for training."))?;
    let mlp_gradient = g.external("mlp_gradient", 4 * config.weights() as u64);
    let gradients = Gradients { mlp: mlp_gradient, ..gradients };
    visibility_bwd(&mut g, c.tuning, &f, &view, model.lights, &constant, &BackwardOptions::default(), &gradients)?;
    // The same on units. The pass adds to tables, which only the optimizer's step clears.
    let on_units = match on_units {
        None => None,
        Some(seen) => {
            let entries = u64::from(config.entries());
            let into = Gradients {
                mlp: g.external("units.mlp_gradient", 4 * config.weights() as u64),
                lights: g.external("units.light_gradients", 12 * u64::from(model.lights)),
                tables: g.external("units.table_gradients", 16 * entries),
                touched: g.external("units.touched", 4 * entries.div_ceil(32)),
                scale: g.external("units.scale", 8),
            };
            g.fill("units.clear_tables", into.tables, 0)?;
            g.fill("units.clear_touched", into.touched, 0)?;
            visibility_bwd(&mut g, halves, &f, &view, model.lights, &constant, &BackwardOptions::default(), &into)?;
            Some((seen, into.mlp))
        }
    };
    // Counts the touched entries before the step clears the bits.
    let touched = g.external("touched", 4 * u64::from(config.entries().div_ceil(32)));
    g.copy("out.touched", gradients.touched, touched)?;
    let (flags, skipped) = (g.input("flags", 4), g.external("skipped", 4));
    let moments = handles.moments(flags, 1, skipped);
    let moments = moments.ok_or_else(|| anyhow::anyhow!("The field is not declared for training."))?;
    visibility_adam(&mut g, c.tuning, &f, &gradients, &moments)?;

    // Features of significant size. A learning rate of zero keeps the parameters equal to the reference.
    let tables: Vec<f32> = config.initial_tables(1).iter().map(|t| 5e3 * t).collect();
    let mlp = config.initial_weights(1);
    let pairs = n as f32 * model.lights as f32;
    let step = FieldStep {
        box_min: LOW,
        box_max: HIGH,
        box_inverse: [0, 1, 2].map(|k| 1.0 / (HIGH[k] - LOW[k])),
        jitter: 0.01,
        regularizer: 0.4 / pairs,
        pixels: n as u32,
        lights: model.lights,
        seed: 3,
        rate: 0.0,
        correction1: 1.0,
        correction2: 1.0,
    };
    let gradient: Vec<[f32; 3]> = lit.gradient.iter().map(|g| g.map(|x| x / pairs)).collect();
    let inputs = vec![
        (f.step, bytes(&[step])),
        (f.levels, bytes(&config.table_levels())),
        (f.tables, bytes(&tables)),
        (f.mlp, bytes(&mlp)),
        (view.points, bytes(&lit.points)),
        (view.coverage, bytes(&vec![1.0_f32; n])),
        (view.lights, bytes(&lit.positions)),
        (constant.radiance, bytes(&vec![[1.0_f32; 3]; model.lights as usize])),
        (constant.radiance_gradient, bytes(&gradient)),
    ];
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let count = rig.get::<u32>(touched)?.iter().map(|w| f64::from(w.count_ones())).sum();
    let lights = f64::from(model.lights);
    let counts = Counts { pixels: n as f64, lights, touched: count, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let reference = reference::Field::new(&config, &tables, &mlp, LOW, HIGH);
    let (found, again) = (rig.get::<f32>(seen)?, rig.get::<f32>(plain)?);
    let sample: Vec<usize> = (0..n).step_by((n / 100).max(1)).collect();
    for &i in &sample {
        let one = |l: &[f32; 3]| reference.visibility(lit.points[i].map(f64::from), l.map(f64::from));
        let expected = lit.positions.iter().map(one).sum::<f64>() / lights;
        for value in [found[i], again[i]] {
            let right = (f64::from(value) - expected).abs() < 1e-4;
            anyhow::ensure!(right, "Pixel {i} sees {value} of the lights, but should see {expected}.");
        }
    }
    if let Some((seen, mlp)) = on_units {
        let norm = |v: &mut dyn Iterator<Item = f32>| v.map(|x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt();
        let (single, half) = (rig.get::<f32>(mlp_gradient)?, rig.get::<f32>(mlp)?);
        let off = norm(&mut single.iter().zip(&half).map(|(a, b)| a - b)) / norm(&mut single.iter().copied());
        anyhow::ensure!(off < 1e-2, "Gradients of layers on matrix units differ by {off} of their norm.");
        report.check(format!("visibility: gradients of layers on matrix units are within {off:.1e} of their norm"));
        let found = rig.get::<f32>(seen)?;
        for &i in &sample {
            let one = |l: &[f32; 3]| reference.visibility_half(lit.points[i].map(f64::from), l.map(f64::from));
            let expected = lit.positions.iter().map(one).sum::<f64>() / lights;
            let right = (f64::from(found[i]) - expected).abs() < 2e-4;
            anyhow::ensure!(
                right,
                "On matrix units pixel {i} sees {} of the lights, but should see {expected}.",
                found[i]
            );
        }
    }
    // Every replay has the same gradients, so first moments are the gradients times 1 - 0.9^replays.
    let replays = (c.warmup.max(1) + c.repeats) as i32;
    let training = handles.training.ok_or_else(|| anyhow::anyhow!("The field is not declared for training."))?;
    let table_gradients = rig.get::<[f32; 2]>(training.table_moments)?;
    let product = |a: &[f32], b: &mut dyn Iterator<Item = f32>| {
        a.iter().zip(b).fold([0.0, 0.0], |[sum, size]: [f64; 2], (a, b)| {
            let x = f64::from(*a) * f64::from(b);
            [sum + x, size + x.abs()]
        })
    };
    let by_tables = product(&tables, &mut table_gradients.iter().map(|m| m[0] / (1.0 - 0.9_f32.powi(replays))));
    let weights = rig.get::<f32>(mlp_gradient)?;
    let (inputs, width) = (config.inputs(), FIELD_WIDTH);
    let layer = |from: usize, to: usize| product(&mlp[from..to], &mut weights[from..to].iter().copied());
    let (one, two) = (layer(0, width * inputs), layer(width * inputs, width * (inputs + width)));
    let three = layer(width * (inputs + width), mlp.len());
    let is_feature = |i: &usize| i % inputs < inputs - 4;
    let features: Vec<usize> = (0..width * inputs).filter(is_feature).collect();
    let feature_weights: Vec<f32> = features.iter().map(|i| mlp[*i]).collect();
    let of_features = product(&feature_weights, &mut features.iter().map(|i| weights[*i]));
    let same = [(one, two), (two, three), (by_tables, of_features)];
    for ([a, size], [b, other]) in same {
        let right = (a - b).abs() <= 1e-4 * size.max(other) && size > 0.0;
        anyhow::ensure!(right, "Weights times gradients add up to {a} in one layer and to {b} in the next.");
    }
    anyhow::ensure!(rig.get::<u32>(skipped)? == [0], "Gradients of layers are not finite.");
    let what =
        format!("{} pixels are the reference's, weights times gradients are the same in every layer", sample.len());
    report.check(format!("visibility: values of {what}"));
    Ok(())
}

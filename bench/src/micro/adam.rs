//! Benchmark of `adam` on the widest group. Every scalar is checked against the reference.

use super::Context;
use super::view::work_of;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::optim::{Adam, EPSILON, Rate, adam};
use sgs_passes::reference::adam as reference;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::Group;
use sgs_shaders::structs::{Step, Work};

const RATE: f64 = 1e-3;

/// Measures one step of one group.
pub fn one(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let width = Group::Sh3.width();
    let count = c.workload.start.len() as u32;
    let scalars = width as usize * count as usize;
    let mut rng = Pcg::new(3);
    let mut random = |scale: f64| (0..scalars).map(|_| (scale * rng.range(-1.0, 1.0)) as f32).collect::<Vec<f32>>();
    let (start, slope) = (random(1.0), random(1e-3));
    let mut g = Graph::new("adam");
    let words = 4 * scalars as u64;
    let step = g.uniform("step", size_of::<Step>() as u64);
    let live = g.input("live", size_of::<Work>() as u64);
    let (flags, gradients) = (g.input("flags", 4), g.input("gradients", words));
    let (parameters, moments) = (g.external("parameters", words), g.external("moments", 2 * words));
    let skipped = g.external("skipped", 4);
    let what = Adam {
        step,
        live,
        flags,
        flag_words: 1,
        width,
        capacity: u64::from(count),
        rate: Rate::ShRest,
        skip_zero: false,
        epsilon: EPSILON,
        gradients,
        parameters,
        moments,
        skipped,
    };
    adam(&mut g, c.tuning, "adam", &what)?;
    let rates = reference::Rates::at(RATE, 1);
    let values = Step {
        lr_sh_rest: RATE as f32,
        correction1: rates.correction1 as f32,
        correction2: rates.correction2 as f32,
        ..Default::default()
    };
    let inputs = vec![
        (step, bytes(&[values])),
        (live, bytes(&[work_of(count)])),
        (gradients, bytes(&slope)),
        (parameters, bytes(&start)),
    ];
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let counts = Counts { elements: scalars as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
    // Every replay is a step with the same rates and gradients; the reference takes as many steps.
    let steps = c.warmup.max(1) + c.repeats;
    let (found, stored): (Vec<f32>, Vec<[f32; 2]>) = (rig.get(parameters)?, rig.get(moments)?);
    for i in 0..scalars {
        let (mut p, mut m) = (f64::from(start[i]), [0.0; 2]);
        for _ in 0..steps {
            (p, m) = reference::adam(p, m, f64::from(slope[i]), rates);
        }
        let close =
            |a: f32, b: f64, absolute: f64, relative: f64| (f64::from(a) - b).abs() <= absolute + relative * b.abs();
        let right = close(found[i], p, 1e-4 * RATE * f64::from(steps), 1e-6 * f64::from(steps))
            && close(stored[i][0], m[0], 1e-9, 1e-4)
            && close(stored[i][1], m[1], 1e-20, 1e-4);
        anyhow::ensure!(right, "Scalar {i} is {} after {steps} steps, but should be {p}.", found[i]);
    }
    anyhow::ensure!(rig.get::<u32>(skipped)? == [0], "Adam skipped gradients that are finite.");
    report.check(format!("adam: all of {scalars} scalars after {steps} steps are those of the reference"));
    Ok(())
}

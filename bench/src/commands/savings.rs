//! Optimizations of the intrinsic stage, timed with and without each: `engine-bench savings`.
//!
//! Both forms run on the same data and must agree. Exact optimizations:
//! - The first layer of the visibility network is split.
//! - Irradiance and the Fresnel factor are moved out of the sum over lights.
//! - Lights behind the surface and lights that are off are skipped.
//! - Blending weights of views are stored from step to step.
//!
//! Two are approximate, with stated errors: culling of faint lights, and supervision of the field by a sample of
//! pairs.

use super::ceiling::measure_ceiling;
use super::step::Args as StepArgs;
use crate::common::{Common, parse_size};
use crate::harness::{Rig, bytes};
use crate::micro::lights::{Bound, Lit, bind};
use crate::report::Report;
use crate::stats::Summary;
use crate::workload::{LitScene, lit_settings};
use anyhow::ensure;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::Tuning;
use sgs_passes::kernel::{groups, stage};
use sgs_passes::shade::lights::{LightModel, Lights, Shape, lights_prepare, lights_prepare_culled, lights_train};
use sgs_passes::shade::visibility::{FieldConfig, View, VisibilityField, visibility};
use sgs_shaders::lights_savings as kernel;
use sgs_shaders::structs::FieldStep;
use sgs_train::Intrinsic;
use std::time::Instant;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Size of the view; 320x240 on a CPU, 1920x1080 elsewhere.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Number of measured training steps per form; 0 skips these measurements.
    #[arg(long, value_name = "N", default_value_t = 12)]
    pub steps: u32,
    /// Maximum fraction by which culling of faint lights may darken white.
    #[arg(long, value_name = "SHARE", default_value_t = 0.002)]
    pub cull_error: f32,
}

/// Times and result of one form of a computation.
struct Form {
    times: Summary,
    result: Vec<f32>,
}

/// Runs the command.
///
/// # Errors
/// If the device fails, or two forms of the same disagree.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let device = common.open_device()?;
    let mut report = common.report("savings", &device);
    let (_, size) = StepArgs::sizes(&device, None, a.size);
    let model = LightModel::default();
    report.setting("size", format!("{}x{}", size[0], size[1]));
    report.setting("lights", model.lights);
    report.setting("lobes", model.lobes);
    report.setting("cull error", a.cull_error);
    report.ceiling = Some(measure_ceiling(&device)?);
    let lit = Lit::room(size, model);
    let bench = Bench { common, device: &device, tuning: Tuning::for_device(device.info()), lit: &lit, size, model };
    bench.first_layer(&mut report)?;
    bench.sums(&mut report)?;
    bench.off(&mut report)?;
    bench.culled(&mut report, a.cull_error)?;
    if a.steps > 0 {
        steps(common, a, size, &mut report)?;
    }
    common.finish(&report, &device)
}

/// Adds the times of both forms and their ratio.
fn add(report: &mut Report, name: &str, plain: Summary, saved: Summary) {
    report.time(&format!("{name}: without"), "ms", plain.scaled(1e-6));
    report.time(&format!("{name}: with"), "ms", saved.scaled(1e-6));
    report.fact(&format!("{name}: times faster"), (100.0 * plain.median / saved.median.max(1.0)).round() / 100.0);
}

/// Checks that two results agree up to rounding.
fn same(name: &str, a: &[f32], b: &[f32], relative: f32) -> anyhow::Result<()> {
    let scale = a.iter().map(|x| x.abs()).sum::<f32>() / a.len().max(1) as f32;
    ensure!(a.len() == b.len() && scale > 0.0, "{name}: there is nothing to compare.");
    for (i, (x, y)) in a.iter().zip(b).enumerate() {
        ensure!((x - y).abs() <= relative * (x.abs() + 0.1 * scale), "{name}: number {i} is {x} without and {y} with.");
    }
    Ok(())
}

struct Bench<'a> {
    common: &'a Common,
    device: &'a Device,
    tuning: Tuning,
    lit: &'a Lit,
    size: [u32; 2],
    model: LightModel,
}

impl Bench<'_> {
    /// Measures the passes whose names begin with `pass`, and reads a result.
    fn measure(&self, g: Graph, inputs: Vec<(Buffer, Vec<u8>)>, pass: &str, result: Buffer) -> anyhow::Result<Form> {
        let mut rig = Rig::new(self.device, g, inputs, true)?;
        let (times, _) = rig.measure(self.common.warmup, self.common.repeats)?;
        let mine: Vec<_> = times.into_iter().filter(|t| t.name.starts_with(pass)).collect();
        ensure!(!mine.is_empty(), "No pass is called {pass}.");
        let samples = mine.iter().map(|t| t.nanoseconds.len()).min().unwrap_or(0);
        let sums: Vec<f64> = (0..samples).map(|i| mine.iter().map(|t| t.nanoseconds[i]).sum()).collect();
        Ok(Form { times: Summary::of(&sums), result: rig.get(result)? })
    }

    /// Times the first layer: a point's response computed once, or for each light.
    fn first_layer(&self, report: &mut Report) -> anyhow::Result<()> {
        let config = FieldConfig::default();
        let n = self.lit.points.len() as u64;
        let mut forms = Vec::new();
        for split in [false, true] {
            let mut g = Graph::new("first_layer");
            let f = VisibilityField::handles(&mut g, config, false, 32).field;
            let view = View {
                pixels: n as u32,
                points: g.input("points", 12 * n),
                coverage: g.input("coverage", 4 * n),
                lights: g.input("lights", 12 * u64::from(self.model.lights)),
            };
            let seen = g.external("seen", 4 * n);
            visibility(&mut g, self.tuning, &f, &view, None, split, seen)?;
            let tables: Vec<f32> = config.initial_tables(1).iter().map(|t| 5e3 * t).collect();
            let step = FieldStep {
                box_min: [-1.6; 3],
                box_max: [1.6; 3],
                box_inverse: [1.0 / 3.2; 3],
                pixels: n as u32,
                lights: self.model.lights,
                ..FieldStep::default()
            };
            let inputs = vec![
                (f.step, bytes(&[step])),
                (f.levels, bytes(&config.table_levels())),
                (f.tables, bytes(&tables)),
                (f.mlp, bytes(&config.initial_weights(1))),
                (view.points, bytes(&self.lit.points)),
                (view.coverage, bytes(&vec![1.0_f32; n as usize])),
                (view.lights, bytes(&self.lit.positions)),
            ];
            forms.push(self.measure(g, inputs, "visibility", seen)?);
        }
        same("first layer", &forms[0].result, &forms[1].result, 1e-4)?;
        add(report, "first layer split", forms[0].times, forms[1].times);
        report.check("the split first layer gives the visibility that the whole one gives");
        Ok(())
    }

    /// Times the factors moved out of the sum over lights, separately and combined.
    fn sums(&self, report: &mut Report) -> anyhow::Result<()> {
        let form = |irradiance: bool, fresnel: bool, facing: bool| {
            let mut g = Graph::new("sums");
            let b = bind(&mut g, self.lit, self.size, self.model);
            let step = b.pixels.screen.step;
            let prepared =
                lights_prepare(&mut g, self.tuning, "lights_prepare", step, self.model, &b.parameters, None)?;
            let direct = g.external("direct", 12 * self.lit.points.len() as u64);
            let bindings = kernel::Bindings {
                params: step.into(),
                prepared: prepared.lights.into(),
                points: b.pixels.surfaces.points.into(),
                normals: b.pixels.surfaces.normals.into(),
                materials: b.pixels.materials.materials.into(),
                direct: direct.into(),
            };
            let lanes = self.tuning.subgroup_size;
            let specs = kernel::Specs { workgroup: lanes, lobes: self.model.lobes, irradiance, fresnel, facing };
            let push = kernel::Push { normalizer: 1.0 / self.model.lights as f32, lights: self.model.lights };
            let bytes = bytemuck::bytes_of(&push);
            stage(&mut g, "lights_savings", &kernel::KERNEL, bindings.entries(), specs.entries(), bytes)
                .subgroup_size(Some(lanes))
                .dispatch(groups(b.pixels.screen.pixels(), lanes))?;
            self.measure(g, b.inputs, "lights_savings", direct)
        };
        let plain = form(false, false, false)?;
        for (name, chosen) in [
            ("irradiance factored out", [true, false, false]),
            ("Fresnel's factor as two sums", [false, true, false]),
            ("lights behind the surface skipped", [false, false, true]),
            ("all three", [true; 3]),
        ] {
            let saved = form(chosen[0], chosen[1], chosen[2])?;
            same(name, &plain.result, &saved.result, 1e-4)?;
            add(report, name, plain.times, saved.times);
        }
        report.check("radiance is the same with each saving and with all");
        Ok(())
    }

    /// Shades for training with the given gains.
    ///
    /// `missing`: bound on the irradiance that culling may remove; 0 disables culling.
    fn shaded(&self, gains: &[f32], missing: f32) -> anyhow::Result<Form> {
        let mut g = Graph::new("shaded");
        let mut b: Bound = bind(&mut g, self.lit, self.size, self.model);
        for (buffer, data) in &mut b.inputs {
            if *buffer == b.parameters.gains {
                *data = bytes(gains);
            }
        }
        let step = b.pixels.screen.step;
        let prepared = lights_prepare_culled(
            &mut g,
            self.tuning,
            "lights_prepare",
            step,
            self.model,
            &b.parameters,
            None,
            missing,
        )?;
        let normalizer = 1.0 / self.model.lights as f32;
        let what = Lights { pixels: b.pixels, prepared, normalizer, shape: Shape::for_device(self.tuning) };
        let direct = g.external("direct", 12 * self.lit.points.len() as u64);
        lights_train(&mut g, &what, direct)?;
        self.measure(g, b.inputs, "lights_train", direct)
    }

    /// Times three of ten lights switched off, as in views under other lights.
    fn off(&self, report: &mut Report) -> anyhow::Result<()> {
        let gains: Vec<f32> = (0..self.model.lights).map(|i| f32::from(u8::from(i % 10 >= 3))).collect();
        let faint: Vec<f32> = gains.iter().map(|g| g.max(1e-20)).collect();
        let (plain, saved) = (self.shaded(&faint, 0.0)?, self.shaded(&gains, 0.0)?);
        same("lights off", &plain.result, &saved.result, 1e-4)?;
        add(report, "three of ten lights off, skipped", plain.times, saved.times);
        report.check("lights that are skipped give what dark ones give");
        Ok(())
    }

    /// Times faint lights culled per block of pixels.
    fn culled(&self, report: &mut Report, error: f32) -> anyhow::Result<()> {
        let gains = vec![1.0; self.model.lights as usize];
        // The error is relative to the brightest diffuse white surface.
        let plain = self.shaded(&gains, 0.0)?;
        let white = plain.result.iter().fold(0.0_f32, |a, b| a.max(*b));
        let missing = error * white * std::f32::consts::PI * self.model.lights as f32;
        let saved = self.shaded(&gains, missing)?;
        let worst = plain.result.iter().zip(&saved.result).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        // Specular light lacks at most 1 / (2 roughness^6) times the bound. Roughness is 0.3 or more here.
        let most = error * white * (1.0 + 0.5 / 0.3_f32.powi(6));
        ensure!(worst <= most, "Culling changed radiance by {worst}, but may by {most}.");
        add(report, "faint lights left out (not exact)", plain.times, saved.times);
        report.fact("faint lights left out: largest change of radiance, share of the brightest", worst / white);
        report.check("what culling takes is within its bound");
        Ok(())
    }
}

/// Times training steps with views' weights stored and recomputed.
///
/// Also times supervision of the field by one of 16 pairs.
fn steps(common: &Common, a: &Args, size: [u32; 2], report: &mut Report) -> anyhow::Result<()> {
    let mut base = lit_settings(None)?;
    let lit = LitScene::open(None, None, size, &mut base)?;
    let form = |change: &dyn Fn(&mut Settings)| -> anyhow::Result<Form> {
        let mut settings = base.clone();
        change(&mut settings);
        let device = common.open_device()?;
        let mut training = Intrinsic::new(&device, &lit.scene, &settings, &lit.splats)?;
        let (mut done, mut losses, mut wall) = (common.warmup.max(1), Vec::new(), Vec::new());
        training.train(done, |_| {}, || true)?;
        for _ in 0..a.steps {
            done += 1;
            let begin = Instant::now();
            training.train(done, |r| losses.push(r.shaded), || true)?;
            wall.push(begin.elapsed().as_nanos() as f64);
        }
        Ok(Form { times: Summary::of(&wall), result: losses })
    };
    let stored = form(&|_| {})?;
    let recomputed = form(&|s| s.intrinsic.surface_bytes = 1)?;
    ensure!(stored.result == recomputed.result, "Steps with stored weights and with recomputed ones differ.");
    add(report, "a step, weights of views kept", recomputed.times, stored.times);
    let sampled = form(&|s| s.intrinsic.visibility.sample = 16)?;
    ensure!(sampled.result.iter().all(|l| l.is_finite()), "A loss is not finite.");
    add(report, "a step, one pair of 16 teaching the field (not exact)", stored.times, sampled.times);
    report.check("stored weights give the losses of recomputed ones, bit by bit");
    Ok(())
}

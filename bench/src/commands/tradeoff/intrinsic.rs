//! Choices of the intrinsic stage.
//!
//! Measured for each choice: step time, image and gradient errors, and quality at test views after a fixed training.
//! Materials and lights are first trained with `exact`. Choices with the same model start there. The image of their
//! next step is compared with double precision, its gradients with those of `exact`. Choices with another model train
//! separately; only time, memory and quality are compared. Times are host times of several steps together, since the
//! work of some choices varies from step to step.

use super::again::Figures;
use super::choices::{Choice, Kind, of_intrinsic};
use super::error::{self, ImageError, finite};
use super::front::{Place, Ratio, Standing, standings};
use super::plot::Mark;
use super::record::record;
use super::{Args, Presentation, StepArgs, lit};
use crate::common::Common;
use crate::report::{Report, standing};
use crate::stats::Summary;
use crate::workload::{LitScene, lit_settings, plain};
use anyhow::{Context, ensure};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_evaluate::metrics::psnr;
use sgs_passes::Tuning;
use sgs_run::{Shading, StageKind, displayed, shaded_scene};
use sgs_scene::{GroundTruth, GroundTruthKind, Scene, Splats};
use sgs_train::{Intrinsic, Probe, StartGeometry, Trainer, TrainerOptions};
use std::borrow::Cow;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Steps timed together: a multiple of every update interval of the choices.
const RHYTHM: u32 = 8;

/// Warm-up steps after a training is restored.
const WARM: u32 = 2;

/// Measurements of one choice.
pub struct Row {
    choice: Choice,
    step: Summary,
    of_exact: Ratio,
    bytes: u64,
    /// Error of an image against double precision.
    image: Option<ImageError>,
    /// Error of gradients against those of `exact`.
    gradients: Option<GradientError>,
    /// Quality after training with the choice.
    quality: Option<Quality>,
    standing: Standing,
}

/// Runs the command for the intrinsic stage.
///
/// # Errors
/// If the device fails, a file cannot be read or written, or `exact` disagrees with double precision.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let device = common.open_device()?;
    let mut report = common.report("tradeoff", &device);
    let mut base = Choice::level("exact")?.settings(&lit_settings(a.config.as_deref())?)?;
    base.intrinsic.automatic.enabled = false;
    let (_, size) = StepArgs::sizes(&device, a.gaussians, a.size);
    let lit = LitScene::open(a.scene.as_deref(), a.geometry.as_deref(), size, &mut base)?;
    let (scene, splats) = (&lit.scene, &lit.splats);
    let steps = common.repeats.div_ceil(RHYTHM) * RHYTHM;
    report.setting("stage", "intrinsic");
    report.setting("scene", lit.name());
    report.setting("gaussians", splats.len());
    report.setting("size", format!("{}x{}", lit.camera().width, lit.camera().height));
    report.setting("lights", base.intrinsic.lights.grid.pow(3));
    report.setting("environment", base.intrinsic.environment.resolution);
    report.setting("trained", a.train);
    record(&mut report, a, &base)?;
    let mut rows = measure(a, &device, scene, splats, &plain(&base), steps)?;
    if let Some(steps) = a.quality {
        report.fact("steps of a training of its own", steps);
        for row in &mut rows {
            let trained = trained(&device, scene, splats, &of_training(&base, &row.choice, steps)?)?;
            finite(&row.choice.name, "error after training", trained.image_psnr + trained.albedo.unwrap_or(0.0))?;
            row.quality = Some(trained);
        }
    }
    put(&mut report, &rows);
    report.check("the exact image agrees with double precision");
    presentation(&report, &rows).leave(common, a)?;
    common.finish(&report, &device)
}

/// Writes the measurements of the choices to a report.
fn put(report: &mut Report, rows: &[Row]) {
    for r in rows {
        let name = &r.choice.name;
        report.choice("step", name, r.step, r.of_exact.into());
        report.time(&format!("device memory of training, {name}"), "MB", Summary::of(&[r.bytes as f64 / 1e6]));
        if r.choice.shows() {
            report.fact(&format!("{}{name}", standing::PREFIX), r.standing.label());
        }
        if let Some(ImageError { largest, mean, psnr }) = r.image {
            report.time(&format!("largest error, {name}"), "", Summary::of(&[largest]));
            report.time(&format!("mean error, {name}"), "", Summary::of(&[mean]));
            report.fact(&format!("image, {name}, dB"), psnr);
        }
        if let Some(g) = &r.gradients {
            report.time(&format!("gradient error, {name}"), "", Summary::of(&[g.all]));
            report.time(&format!("gradient error of the field, {name}"), "", Summary::of(&[g.field]));
            if !g.left_out.is_empty() {
                report.fact(&format!("not in the gradient error, {name}"), g.left_out.join(", "));
            }
        }
        if let Some(q) = r.quality {
            report.fact(&format!("shaded images after training, {name}, dB"), q.image_psnr);
            if let Some(albedo) = q.albedo {
                report.fact(&format!("albedo after training, {name}, dB"), albedo);
            }
        }
    }
    let best: Vec<&str> =
        rows.iter().filter(|r| r.standing == Standing::Front).map(|r| r.choice.name.as_str()).collect();
    report.fact("on the front", best.join(", "));
}

/// Restores measurements from a report and ranks them by the current rules.
///
/// # Errors
/// If the report lacks a figure.
pub fn again(report: &Report, choices: Vec<Choice>) -> anyhow::Result<Vec<Row>> {
    let row = |choice: Choice| -> anyhow::Result<Row> {
        let of = Figures { report, choice: &choice.name };
        let image = match of.fact("image", "dB") {
            Some(psnr) => {
                Some(ImageError { largest: of.number("largest error")?, mean: of.number("mean error")?, psnr })
            }
            None => None,
        };
        let gradients = match of.any("gradient error") {
            Some(all) => {
                let left_out = of
                    .text("not in the gradient error")
                    .map_or_else(Vec::new, |names| names.split(", ").map(|name| name.to_owned().into()).collect());
                Some(GradientError { all: all.median, field: of.number("gradient error of the field")?, left_out })
            }
            None => None,
        };
        let albedo = of.fact("albedo after training", "dB");
        Ok(Row {
            step: of.summary("step")?,
            of_exact: of.ratio("step")?,
            bytes: of.bytes()?,
            image,
            gradients,
            quality: of.fact("shaded images after training", "dB").map(|image_psnr| Quality { image_psnr, albedo }),
            standing: Standing::default(),
            choice,
        })
    };
    let mut rows = choices.into_iter().map(row).collect::<anyhow::Result<Vec<_>>>()?;
    mark(&mut rows);
    Ok(rows)
}

/// Builds the presentation of a report.
pub fn presentation(report: &Report, rows: &[Row]) -> Presentation {
    let mark =
        |r: &Row| Mark { name: r.choice.name.clone(), time: r.of_exact.value, error: error(r), standing: r.standing };
    Presentation {
        table: table(rows),
        marks: rows.iter().filter(|r| r.choice.shows()).map(mark).collect(),
        title: format!(
            "materials and lights, {} Gaussians, {}",
            report.setting_text("gaussians").unwrap_or_default(),
            report.device.name
        ),
        errors: "error of gradients",
    }
}

/// Returns the settings of a separate training, with every loss of `base`.
fn of_training(base: &Settings, choice: &Choice, steps: u32) -> anyhow::Result<Settings> {
    let mut settings = choice.settings(base)?;
    settings.intrinsic.steps = steps;
    Ok(settings)
}

fn measure(
    a: &Args,
    device: &Device,
    scene: &Scene,
    splats: &Splats,
    base: &Settings,
    steps: u32,
) -> anyhow::Result<Vec<Row>> {
    let selected = |c: &Choice| a.wants(&c.name);
    let folder = tempfile::tempdir()?;
    // Only one training is in memory at a time; the initial states are in files.
    let mut subjects: Vec<(Row, PathBuf, Vec<f64>)> = Vec::new();
    let start = folder.path().join("start");
    let mut exact: Option<(Probe, Vec<f64>)> = None;
    for choice in of_intrinsic(base, &Tuning::for_device(device.info()))?.into_iter().filter(selected) {
        let settings = choice.settings(base)?;
        let (name, same) = (choice.name.as_str(), choice.kind != Kind::Model);
        let before = device.memory_use().0;
        let mut training = Intrinsic::new(device, scene, &settings, splats)?;
        if exact.is_none() || !same {
            training.train(a.train.next_multiple_of(RHYTHM).max(RHYTHM), |_| {}, || true)?;
        }
        if exact.is_none() {
            training.save(&start)?;
        } else if same {
            restore(&mut training, &start, &choice)?;
        }
        let probe = training.probe()?;
        let (mut image, mut gradients) = (None, None);
        if exact.is_none() {
            let light = training.light()?;
            let truth = lit::shaded_reference(&training.splats()?, &light, &probe.camera, base.geometry.background)?;
            exact = Some((probe.clone(), truth));
        }
        if let (Some((of_exact, truth)), true) = (&exact, same) {
            // Images of another size have other pixels.
            if settings.intrinsic.scale == base.intrinsic.scale {
                let e = error::image_error(&probe.image, truth).with_context(|| format!("The image of \"{name}\""))?;
                finite(name, "mean error", e.mean)?;
                image = Some(e);
            }
            let off = difference(of_exact, &probe).with_context(|| format!("The gradient of \"{name}\""))?;
            choice.checked_gradient(finite(name, "gradient error", off.all.max(off.field))?)?;
            gradients = Some(off);
        }
        if name == "exact" {
            let db = image.map_or(0.0, |p| p.psnr);
            ensure!(db > 50.0, "The exact image is {db:.1} dB off double precision.");
        }
        let mut own = start.clone();
        if !same {
            own = folder.path().join(subjects.len().to_string());
            training.save(&own)?;
        }
        training.train(training.step() + RHYTHM, |_| {}, || true)?;
        let bytes = device.memory_use().0 - before;
        let row = Row {
            choice,
            step: Summary::default(),
            of_exact: Ratio::EXACT,
            bytes,
            image,
            gradients,
            quality: None,
            standing: Standing::default(),
        };
        subjects.push((row, own, Vec::new()));
    }
    // Each round starts at another choice, and every other round runs backwards. `exact` is measured between all
    // others.
    let made = |row: &Row| -> anyhow::Result<Intrinsic> {
        Ok(Intrinsic::new(device, scene, &row.choice.settings(base)?, splats)?)
    };
    let (first, others) = subjects.split_at_mut(1);
    let (row, own, times) = &mut first[0];
    let mut exact = made(row)?;
    restore(&mut exact, own, &row.choice)?;
    // Trains the same steps as the other choices, so that all see the same views.
    let warm = exact.step() + RHYTHM;
    exact.train(warm - WARM, |_| {}, || true)?;
    let nearer = folder.path().join("warm");
    exact.save(&nearer)?;
    let choice = row.choice.clone();
    let mut of_exact = || -> anyhow::Result<f64> {
        restore(&mut exact, &nearer, &choice)?;
        exact.train(warm, |_| {}, || true)?;
        times.push(timed(&mut exact, steps)?);
        Ok(times[times.len() - 1])
    };
    let mut ratios = vec![Vec::new(); others.len()];
    let count = others.len();
    for round in 0..a.rounds as usize {
        let mut before = of_exact()?;
        for i in 0..count {
            let i = (i + round / 2 * 5) % count;
            let i = if round % 2 == 0 { i } else { count - 1 - i };
            let (row, own, times) = &mut others[i];
            let mut training = made(row)?;
            restore(&mut training, own, &row.choice)?;
            // From one update of the environment map to the next.
            training.train(warm, |_| {}, || true)?;
            let time = timed(&mut training, steps)?;
            drop(training);
            let after = of_exact()?;
            times.push(time);
            ratios[i].push(2.0 * time / (before + after));
            before = after;
        }
    }
    drop(exact);
    let ratios = std::iter::once(Ratio::EXACT).chain(ratios.iter().map(|r| Ratio::of(r)));
    let ratios: Vec<Ratio> = ratios.collect();
    for ((row, ..), ratio) in subjects.iter().zip(&ratios) {
        finite(&row.choice.name, "time of a step", ratio.value + ratio.off)?;
    }
    let row = |((row, _, times), of_exact): ((Row, PathBuf, Vec<f64>), Ratio)| Row {
        step: Summary::of(&times),
        of_exact,
        ..row
    };
    let mut rows: Vec<Row> = subjects.into_iter().zip(ratios).map(row).collect();
    mark(&mut rows);
    Ok(rows)
}

fn mark(rows: &mut [Row]) {
    let place = |r: &Row| Place { kind: r.choice.kind, time: r.of_exact, error: error(r) };
    let places: Vec<Place> = rows.iter().filter(|r| r.choice.shows()).map(place).collect();
    let standings = standings(&places);
    rows.iter_mut().filter(|r| r.choice.shows()).zip(standings).for_each(|(r, standing)| r.standing = standing);
}

/// Returns the mean milliseconds per step over `steps` steps.
fn timed(training: &mut Intrinsic, steps: u32) -> anyhow::Result<f64> {
    let begin = Instant::now();
    training.train(training.step() + steps, |_| {}, || true)?;
    Ok(begin.elapsed().as_secs_f64() * 1e3 / f64::from(steps))
}

/// Restores a training to the state saved in `start`.
fn restore(training: &mut Intrinsic, start: &Path, choice: &Choice) -> anyhow::Result<()> {
    training.restore(start).with_context(|| format!("\"{}\" cannot begin where \"exact\" came to", choice.name))
}

/// Returns the error that a choice is ranked by: the larger of gradient and image errors.
///
/// Gradients of the field are excluded. If few pairs supervise the field, they are noisy in one step but unbiased.
fn error(row: &Row) -> f64 {
    let gradients = row.gradients.as_ref().map_or(0.0, |g| g.all);
    gradients.max(row.image.map_or(0.0, |p| p.mean))
}

/// Relative gradient errors.
#[derive(Clone, Debug, Default, PartialEq)]
struct GradientError {
    /// Largest over all groups except the visibility field.
    all: f64,
    /// Largest over the groups of the visibility field.
    field: f64,
    /// Groups without a gradient in this step, since they are not updated every step.
    left_out: Vec<Cow<'static, str>>,
}

impl GradientError {
    /// Returns the table cell.
    fn cell(&self) -> String {
        match self.left_out.is_empty() {
            true => format!("{:.1e}", self.all),
            false => format!("{:.1e}, without {}", self.all, self.left_out.join(", ")),
        }
    }
}

fn difference(exact: &Probe, other: &Probe) -> anyhow::Result<GradientError> {
    let mut found = GradientError::default();
    for (name, a) in &exact.gradients {
        let Some((_, b)) = other.gradients.iter().find(|(n, _)| n == name) else {
            found.left_out.push((*name).into());
            continue;
        };
        let worst = if name.starts_with("visibility_") { &mut found.field } else { &mut found.all };
        *worst = worst.max(error::of_gradient(a, b).with_context(|| (*name).to_owned())?);
    }
    Ok(found)
}

/// PSNR at the test views, or at the training views if there are no test views.
#[derive(Clone, Copy, Debug)]
struct Quality {
    /// PSNR of shaded images, dB.
    image_psnr: f64,
    /// PSNR of albedo in dB, if all these views have ground truth.
    albedo: Option<f64>,
}

/// Measures the quality after a training with these settings.
fn trained(device: &Device, scene: &Arc<Scene>, splats: &Splats, settings: &Settings) -> anyhow::Result<Quality> {
    let start = Some(StartGeometry::Splats(Box::new(splats.clone())));
    let options = TrainerOptions { stages: vec![StageKind::Intrinsic], start, ..Default::default() };
    let mut trainer = Trainer::new(device, scene.clone(), settings, options)?;
    trainer.run(&mut ())?;
    let stage = trainer.stage().context("nothing was trained")?;
    let (splats, light) = (stage.splats()?, stage.light()?.context("nothing lights the scene")?);
    drop(trainer);
    let made = shaded_scene(device, &splats, light.lights.as_ref(), light.environment.as_ref(), &light.visibility)?;
    let mut shading = Shading::new(device, made)?;
    let views = if scene.split.test.is_empty() { &scene.split.train } else { &scene.split.test };
    let truth = GroundTruth::of(scene);
    let (mut image_psnr, mut albedos) = (0.0, Some(0.0));
    for &i in views {
        let shaded = shading.shade(&scene.views[i].camera)?;
        let (photo, counts) = (scene.load_image(i)?, scene.load_mask(i)?);
        image_psnr += psnr(&displayed(&shaded.radiance(settings.geometry.background)), &photo, counts.as_ref())?;
        let mask = truth.load(GroundTruthKind::Mask, i)?;
        albedos = match (truth.load(GroundTruthKind::Albedo, i)?, albedos) {
            (Some(albedo), Some(sum)) => {
                Some(sum + psnr(&displayed(&shaded.albedo()), &displayed(&albedo), mask.as_ref())?)
            }
            _ => None,
        };
    }
    let mean = |sum: f64| sum / views.len() as f64;
    Ok(Quality { image_psnr: mean(image_psnr), albedo: albedos.map(mean) })
}

fn table(rows: &[Row]) -> String {
    let trained = rows.iter().any(|r| r.quality.is_some());
    let mut heads = vec![
        "choice",
        "setting",
        "step, of exact",
        "memory, of exact",
        "largest error",
        "mean error",
        "image, dB",
        "gradients",
        "gradients of the field",
        "front",
    ];
    if trained {
        heads.extend(["images after training, dB", "albedo, dB"]);
    }
    let mut out = format!("| {} |\n|{}\n", heads.join(" | "), "---|".repeat(heads.len()));
    let Some(exact) = rows.first() else { return out };
    let cell = |v: Option<f64>, form: &dyn Fn(f64) -> String| v.map_or("".to_owned(), form);
    let small = |v: f64| format!("{v:.1e}");
    for r in rows {
        let mut cells = vec![
            r.choice.name.clone(),
            r.choice.setting.clone(),
            r.of_exact.to_string(),
            format!("{:.3}", r.bytes as f64 / exact.bytes as f64),
            cell(r.image.map(|p| p.largest), &small),
            cell(r.image.map(|p| p.mean), &small),
            cell(r.image.map(|p| p.psnr), &|v| format!("{v:.1}")),
            r.gradients.as_ref().map_or(String::new(), GradientError::cell),
            cell(r.gradients.as_ref().map(|g| g.field), &small),
            r.standing.to_string(),
        ];
        if trained {
            let db = |v: f64| format!("{v:.2}");
            cells.push(cell(r.quality.map(|q| q.image_psnr), &db));
            cells.push(cell(r.quality.and_then(|q| q.albedo), &db));
        }
        let _ = writeln!(out, "| {} |", cells.join(" | "));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::again::{assert_round_trip, report};
    use super::super::record::differing;
    use super::*;

    #[test]
    fn missing_gradients_are_named() {
        let probe = |gradients: &[(&'static str, &[f32])]| Probe {
            gradients: gradients.iter().map(|(name, values)| (*name, values.to_vec())).collect(),
            ..Probe::default()
        };
        let exact = probe(&[("albedo", &[3.0, 4.0]), ("environment", &[1.0]), ("visibility_mlp", &[1.0])]);
        assert_eq!(difference(&exact, &exact).unwrap(), GradientError::default());
        let not_updated = probe(&[("albedo", &[3.0, 4.5]), ("visibility_mlp", &[1.5])]);
        let found = difference(&exact, &not_updated).unwrap();
        assert!((found.all - 0.1).abs() < 1e-12 && found.field == 0.5 && found.left_out == ["environment"]);
        assert_eq!(found.cell(), "1.0e-1, without environment");
        // NaN is not hidden by other values, and shorter gradients are refused.
        let wrong = probe(&[("albedo", &[f32::NAN, 4.0]), ("environment", &[1.0]), ("visibility_mlp", &[1.0])]);
        assert_eq!(difference(&exact, &wrong).unwrap().all, f64::INFINITY);
        assert!(difference(&exact, &probe(&[("albedo", &[3.0])])).is_err());
    }

    #[test]
    fn report_round_trips_to_the_same_presentation() {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("small.toml");
        let base = lit_settings(Some(&config)).unwrap();
        let choices = of_intrinsic(&base, &Tuning::for_subgroups(8)).unwrap();
        for trained in [false, true] {
            let some = |(i, choice): (usize, Choice)| {
                let x = i as f64;
                let image = ImageError { largest: 1e-3 * x, mean: 1e-5 * x, psnr: 99.96 - x };
                let left_out = if choice.kind == Kind::Later { vec!["a".into(), "b".into()] } else { Vec::new() };
                let gradients = GradientError { all: 1e-4 * (x - 5.0).abs(), field: 0.1 * x, left_out };
                let same = choice.kind != Kind::Model;
                Row {
                    step: Summary::of(&[x]),
                    of_exact: if i == 0 { Ratio::EXACT } else { Ratio::of(&[0.9 + 0.02 * x, 0.81, 0.7]) },
                    bytes: 123_456_789 + i as u64,
                    image: (same && i != 8).then_some(image),
                    gradients: same.then_some(gradients),
                    quality: trained.then_some(Quality { image_psnr: 30.0 + x, albedo: (i % 3 > 0).then_some(24.125) }),
                    standing: Standing::default(),
                    choice,
                }
            };
            let mut rows: Vec<Row> = choices.clone().into_iter().enumerate().map(some).collect();
            mark(&mut rows);
            let mut report = report(&[("stage", "intrinsic".into()), ("gaussians", 17.into())]);
            report.setting("settings", differing(&base).unwrap());
            put(&mut report, &rows);
            let presentation = presentation(&report, &rows);
            assert!(presentation.title == "materials and lights, 17 Gaussians, a", "{}", presentation.title);
            assert!(
                presentation.table.contains(", without a, b |") && presentation.table.contains("| as exact |"),
                "{}",
                presentation.table
            );
            assert!(
                presentation.table.contains("| yes |") && presentation.table.contains("lights.grid=2"),
                "{}",
                presentation.table
            );
            assert_round_trip(&report, &presentation);
        }
    }

    #[test]
    fn steps_omit_losses_and_trainings_include_them() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("config.toml");
        std::fs::write(&config, "[intrinsic]\nrelight_from = 50\n[intrinsic.losses]\ncross_view = 0.3\n").unwrap();
        let base = lit_settings(Some(&config)).unwrap();
        let own = of_training(&base, &Choice::level("fast").unwrap(), 300).unwrap();
        let i = &own.intrinsic;
        assert_eq!((i.losses.cross_view, i.losses.relight, i.relight_from, i.steps), (0.3, 0.4, 50, 300));
        let measured = Choice::level("fast").unwrap().settings(&plain(&base)).unwrap();
        assert_eq!((measured.intrinsic.losses.cross_view, measured.intrinsic.losses.relight), (0.0, 0.0));
        // All other settings are equal.
        let mut again = measured.clone();
        (again.intrinsic.losses, again.intrinsic.steps) = (i.losses, 300);
        assert_eq!(again, own);
    }
}

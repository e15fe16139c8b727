//! Self-contained page of a run: `sgs report`.
//!
//! The page has images, metrics, lights, curves, step times and settings.

use super::eval::Split;
use super::train::validated;
use crate::cameras::splats_of;
use crate::common::Common;
use crate::report::emitters::{self, EmitterView};
use crate::report::lights::{self as light_marks, LightTable};
use crate::report::relit::{self, RelitPage};
use crate::report::views;
use crate::scenes::open_scene_of_run;
use anyhow::{Context, bail};
use serde_json::Value;
use sgs_api::{MeasureOptions, measure};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_relight::Emitting;
use sgs_report::{Page, chart, escape, figure, room, table};
use sgs_run::{RunDirectory, displayed, light_of};
use sgs_scene::{Scene, Splats, read_environment};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory.
    run: PathBuf,
    /// HTML file to write.
    #[arg(short, long, value_name = "FILE.html")]
    output: PathBuf,
    /// Scene directory, if the scene has moved.
    #[arg(long)]
    scene: Option<PathBuf>,
    /// Split of the views in the report.
    #[arg(long, value_enum, default_value = "test")]
    split: Split,
    /// Number of views with images, spread evenly; tables have all views.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// Number of lights, the brightest first, with images of their own.
    #[arg(long, value_name = "N", default_value_t = 6)]
    lights: u32,
    /// Largest width of an image; wider images are reduced.
    #[arg(long, value_name = "PIXELS", default_value_t = 640, value_parser = clap::value_parser!(u32).range(16..))]
    width: u32,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    check_output(&a.output)?;
    let run = RunDirectory::open(&a.run)?;
    let (splats, settings) = splats_of(&a.run)?;
    let Some(mut settings) = settings else { bail!("\"{}\" is not a run directory.", a.run.display()) };
    if let Some(scene) = &a.scene {
        settings.scene.clone_from(scene);
    }
    let scene = open_scene_of_run(&a.run, &settings)?;
    let split = if a.split == Split::Test { &scene.split.test } else { &scene.split.train };
    let chosen = spread(split, a.views as usize);
    if chosen.is_empty() {
        bail!("The scene has no views in that split.");
    }
    let files = Files::read(&run)?;
    let device = common.open_device()?;
    let metrics = metrics(&device, &scene, &run, &splats, &settings, a.split, &files)?;
    let light = light_of(&run, &settings)?;
    let light_table = LightTable::measure(&device, &scene, &splats, &light, &chosen)?;
    let shown = views::Shown { width: a.width, light_table: &light_table, most: a.lights as usize };
    let of_run = views::ShownRun {
        scene: &scene,
        run: &run,
        splats: &splats,
        settings: &settings,
        light: &light,
        views: &chosen,
        metrics: &metrics,
    };
    let images = views::html(common, &device, &of_run, &shown)?;
    let camera = &scene.views[chosen[0]].camera;
    let (emitters, relit) = match Emitting::open(&device, &run, &scene, &splats, settings.seed)? {
        Some(emitting) => {
            let at = EmitterView { scene: &scene, splats: &splats, camera, width: a.width };
            let emitters = emitters::html(&device, &emitting, &at)?;
            let shown =
                RelitPage { scene: &scene, splats: &splats, view: chosen[0], width: a.width, metrics: &metrics };
            (emitters, relit::html(&device, &emitting, &shown)?)
        }
        None => Default::default(),
    };

    let name = run.root().canonicalize().ok().and_then(|p| p.file_name().map(|n| n.to_string_lossy().into_owned()));
    let mut page = Page::new(&format!("SGS: {}", name.unwrap_or_else(|| a.run.display().to_string())));
    let cards = table::cards(&metrics, &facts(&files, &splats));
    page.section("images", "Images", format!("{}{cards}", images.first));
    page.section("relit", "Relit beside the truth", relit);
    let what = if a.split == Split::Test { "views that training never saw" } else { "views of training" };
    let table = table::views(&metrics);
    let sets = table::relit(&metrics);
    let sets = if sets.is_empty() { sets } else { format!("<h3>Under other lights, means</h3>\n{sets}") };
    page.section("metrics", "Metrics", format!("<p>At {what}.</p>\n{table}{sets}"));
    let left_out = split.len() - chosen.len();
    let note = if left_out == 0 { String::new() } else { format!(" {left_out} more are left out.") };
    page.section(
        "views",
        "Views",
        format!(
            "<p>Move the sliders: truth is left, the render right. Images enlarge on a click.{note}</p>\n{}",
            images.views
        ),
    );
    page.section("lights", "Lights", lights(&run, &splats, &scene, &light_table, a.width)?);
    page.section("emitters", "Emitters", emitters);
    page.section("curves", "Curves", chart::log(&files.log));
    page.section("profile", "Profile", profile(&files));
    page.section("summary", "Run", summary(&files, &settings, &splats, &scene, device.info().name.as_str()));
    let config = format!("<details><summary>config.toml</summary><pre>{}</pre></details>\n", escape(&files.config));
    page.section("settings", "Settings", config);
    let html = page.html();
    sgs_scene::atomic_write(&a.output, |f| std::io::Write::write_all(f, html.as_bytes()))?;
    let answer =
        serde_json::json!({"file": a.output, "bytes": html.len(), "views": chosen.len(), "metrics": metrics["mean"]});
    if !common.answer(&answer)? && !common.quiet {
        eprintln!("wrote {} ({:.1} MB)", a.output.display(), html.len() as f64 / 1e6);
    }
    validated(&device)
}

/// Checks that the page can be written, before minutes of work.
fn check_output(path: &Path) -> anyhow::Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if path.is_dir() {
        bail!("\"{}\" is a directory; name a file for the page.", path.display());
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let trial = folder.join(format!(".{name}.{}.tmp", std::process::id()));
    if !folder.is_dir() {
        bail!("\"{}\" does not exist; make it first, or name another place for the page.", folder.display());
    }
    if let Err(e) = std::fs::File::create(&trial).and_then(|_| std::fs::remove_file(&trial)) {
        bail!("\"{}\" cannot be written: {e}; name another place for the page.", path.display());
    }
    Ok(())
}

/// Returns at most `most` elements, spread evenly.
fn spread(all: &[usize], most: usize) -> Vec<usize> {
    let count = all.len().min(most);
    (0..count).map(|i| all[(2 * i + 1) * all.len() / (2 * count)]).collect()
}

/// Contents of the run's files for the page.
struct Files {
    config: String,
    log: String,
    training: Value,
    profiles: Vec<(&'static str, Value)>,
    metrics: Value,
}

impl Files {
    fn read(run: &RunDirectory) -> anyhow::Result<Files> {
        let text = |name: &str| -> anyhow::Result<Option<String>> {
            let path = run.path(name);
            match std::fs::read_to_string(&path) {
                Ok(text) => Ok(Some(text)),
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
                Err(e) => Err(e).with_context(|| format!("\"{}\" cannot be read", path.display())),
            }
        };
        let json = |name: &str| -> anyhow::Result<Value> {
            let Some(text) = text(name)? else { return Ok(Value::Null) };
            serde_json::from_str(&text).with_context(|| format!("\"{}\" is not valid", run.path(name).display()))
        };
        let profiles = [("geometry", "profile.json"), ("intrinsic", "profile-intrinsic.json")];
        let profiles = profiles.iter().map(|(stage, file)| Ok((*stage, json(file)?))).collect::<anyhow::Result<_>>()?;
        Ok(Files {
            config: text("config.toml")?.unwrap_or_default(),
            log: text("log.jsonl")?.unwrap_or_default(),
            training: json("training.json")?,
            profiles,
            metrics: json("metrics.json")?,
        })
    }
}

/// Returns the metrics of a split.
///
/// Recorded metrics are used if they are newer than the Gaussians. Otherwise the run is measured and the result
/// recorded.
fn metrics(
    device: &Device,
    scene: &Scene,
    run: &RunDirectory,
    splats: &Splats,
    settings: &Settings,
    split: Split,
    files: &Files,
) -> anyhow::Result<Value> {
    let changed = |name: &str| std::fs::metadata(run.path(name)).and_then(|m| m.modified()).ok();
    let known = &files.metrics[if split == Split::Test { "test" } else { "train" }];
    if known.is_object() && changed("metrics.json") >= changed("scene.ply") {
        return Ok(known.clone());
    }
    Ok(serde_json::to_value(measure(
        device,
        scene,
        run,
        splats,
        settings,
        MeasureOptions { split: split.into(), ..Default::default() },
    )?)?)
}

fn summary(files: &Files, settings: &Settings, splats: &Splats, scene: &Scene, device: &str) -> String {
    let mut rows: Vec<(String, String)> = Vec::new();
    let mut add = |name: &str, value: String| rows.push((name.to_owned(), value));
    add("scene", settings.scene.display().to_string());
    let size = scene.views.first().map_or(String::new(), |v| format!(", {} × {}", v.camera.width, v.camera.height));
    add("views", format!("{} to train on, {} to test{size}", scene.split.train.len(), scene.split.test.len()));
    add("Gaussians", splats.len().to_string());
    for (stage, record) in [("geometry", &files.training), ("intrinsic", &files.training["intrinsic"])] {
        let value = |key: &str| record[key].as_f64();
        if let (Some(steps), Some(seconds)) = (value("steps"), value("seconds")) {
            let rate = value("steps_per_second").map_or(String::new(), |r| format!(", {r:.2} steps/s"));
            let peak = value("peak_device_bytes").map_or(String::new(), |b| format!(", at most {:.0} MB", b / 1e6));
            let on = record["device"].as_str().map_or(String::new(), |d| format!(", on {d}"));
            add(stage, format!("{steps:.0} steps in {}{rate}{peak}{on}", duration(seconds)));
        }
    }
    add("this page", format!("made on {device}, by sgs {}", env!("CARGO_PKG_VERSION")));
    table::facts(&rows)
}

/// Returns the facts beside the means: number of Gaussians, training time.
fn facts(files: &Files, splats: &Splats) -> Vec<(String, String)> {
    let seconds: f64 =
        [&files.training, &files.training["intrinsic"]].iter().filter_map(|t| t["seconds"].as_f64()).sum();
    let mut all = vec![("Gaussians".to_owned(), splats.len().to_string())];
    if seconds > 0.0 {
        all.push(("Training time".to_owned(), duration(seconds)));
    }
    all
}

/// Formats a duration with readable units.
fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, _) => format!("{seconds:.1} s"),
        (0, m, s) => format!("{m} min {s} s"),
        (h, m, _) => format!("{h} h {m} min"),
    }
}

fn profile(files: &Files) -> String {
    let mut out = String::new();
    for (stage, trace) in &files.profiles {
        let (times, total) = chart::times(trace);
        if !times.is_empty() {
            let count = times.len();
            out.push_str(&format!("<h3>{stage}: a step, {total:.1} ms in {count} passes</h3>\n"));
            out.push_str(&chart::bars(&times, 20, "ms"));
        }
    }
    out
}

/// Returns the lights with their shares in the room, and the environment map.
fn lights(
    run: &RunDirectory,
    splats: &Splats,
    scene: &Scene,
    light_table: &LightTable,
    width: u32,
) -> anyhow::Result<String> {
    let mut out = String::new();
    let all = light_table.rows();
    if !all.is_empty() {
        let eyes: Vec<room::Eye> =
            scene.split.train.iter().map(|v| light_marks::eye(&scene.views[*v].camera)).collect();
        out.push_str("<p>Blue: cameras of training. Circles: lights, as large as their share of the light of all lamps in the views shown, in their color.</p>\n");
        out.push_str(&room::drawing(&light_marks::opaque(splats), &eyes, &all));
        out.push_str(&light_table.table());
    }
    let environment = run.path("environment.exr");
    if environment.is_file() {
        let image = displayed(&read_environment(&environment)?);
        out.push_str("<h3>Environment map</h3>\n<div class=\"grid large\">\n");
        out.push_str(&figure::rendered(
            "environment.exr",
            &figure::data_uri(&image, width)?,
            [image.width, image.height],
            "",
        ));
        out.push_str("</div>\n");
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_readable() {
        let all =
            [(0.0, "0.0 s"), (9.54, "9.5 s"), (140.1, "2 min 20 s"), (3600.0, "1 h 0 min"), (7384.0, "2 h 3 min")];
        all.into_iter().for_each(|(seconds, text)| assert_eq!(duration(seconds), text));
    }

    #[test]
    fn views_are_spread_evenly() {
        let all: Vec<usize> = (10..22).collect();
        assert_eq!(spread(&all, 12), all);
        assert_eq!(spread(&all, 99), all);
        assert_eq!(spread(&all, 3), [12, 16, 20]);
        assert_eq!(spread(&all, 1), [16]);
        assert!(spread(&[], 4).is_empty());
    }
}

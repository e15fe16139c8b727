//! Several rooms on one device: `engine-bench rooms`.
//!
//! Trains the same runs with k at a time, as processes of their own and in one process on one device.

use crate::common::Common;
use anyhow::{Context, bail, ensure};
use serde::Serialize;
use sgs_config::{Backward, Preset, Settings};
use sgs_engine::Device;
use sgs_run::StageKind;
use sgs_scene::Scene;
use sgs_train::{Event, Observer, Outcome, Trainer, TrainerOptions};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Scene directories.
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Number of runs; they take the scenes in turn, each time with the next seed.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Numbers of runs at a time.
    #[arg(long, value_name = "K,...", value_delimiter = ',', default_value = "1,2,4,8")]
    together: Vec<u32>,
    /// Steps of the geometry stage.
    #[arg(long, value_name = "N", default_value_t = 100)]
    steps: u32,
    /// Program whose processes are compared; by default that beside engine-bench.
    #[arg(long, value_name = "PATH")]
    sgs: Option<PathBuf>,
}

/// How runs share the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Way {
    /// Each run has a process of its own.
    Processes,
    /// All runs are threads of one process, on one device with its pipelines.
    OneProcess,
}

/// Measurement of a way and a number of runs at a time.
#[derive(Clone, Debug, Serialize)]
struct Row {
    way: Way,
    together: u32,
    seconds: f64,
    rooms_an_hour: f64,
}

#[derive(Serialize)]
struct Answer {
    command: &'static str,
    device: String,
    cores: usize,
    runs: u32,
    steps: u32,
    rows: Vec<Row>,
}

/// Runs to train.
struct Runs<'a> {
    device: Device,
    program: PathBuf,
    common: &'a Common,
    scenes: Vec<(PathBuf, Arc<Scene>)>,
    settings: Settings,
    config: PathBuf,
}

/// Observer that shows nothing.
struct Silent;

impl Observer for Silent {
    fn notify(&mut self, _event: &Event<'_>) {}
}

/// Runs the command.
///
/// # Errors
/// If a scene cannot be read, a training fails, or two ways give different Gaussians.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    ensure!(common.compare.is_none(), "--compare is for the other measurements");
    ensure!(a.together.iter().all(|k| *k > 0), "--together takes numbers above 0");
    let folder = tempfile::tempdir().context("a temporary directory cannot be made")?;
    let mut settings = Settings::from_table(Preset::find("draft")?.table()?)?;
    settings.geometry.steps = a.steps;
    // A kernel that is chosen by time need not give equal bits.
    settings.geometry.backward = Backward::Pixel;
    let config = folder.path().join("config.toml");
    std::fs::write(&config, toml::to_string(&settings.to_table()?)?)?;
    let open = |path: &PathBuf| -> anyhow::Result<(PathBuf, Arc<Scene>)> {
        let path = std::path::absolute(path)?;
        let scene = Scene::open(&path, &settings.scene_options())?;
        Ok((path, Arc::new(scene)))
    };
    let scenes = a.scenes.iter().map(open).collect::<anyhow::Result<Vec<_>>>()?;
    let beside = || std::env::current_exe().ok().map(|path| path.with_file_name("sgs"));
    let program = a.sgs.clone().or_else(beside).filter(|path| path.is_file());
    let program = program.context("there is no program sgs beside engine-bench; name it by --sgs")?;
    let device = common.open_device()?;
    let runs = Runs { device, program, common, scenes, settings, config };
    let (mut rows, mut first): (Vec<Row>, Option<Vec<Vec<u8>>>) = Default::default();
    for &together in &a.together {
        for way in [Way::Processes, Way::OneProcess] {
            let root = folder.path().join("runs");
            let begun = Instant::now();
            runs.train(way, a.runs, together, &root)?;
            let seconds = begun.elapsed().as_secs_f64();
            let splats = (0..a.runs).map(|i| std::fs::read(root.join(i.to_string()).join("scene.ply")));
            let splats = splats.collect::<std::io::Result<Vec<_>>>()?;
            ensure!(
                first.as_ref().is_none_or(|f| *f == splats),
                "{together} at a time as {way:?} give other Gaussians"
            );
            first.get_or_insert(splats);
            std::fs::remove_dir_all(&root)?;
            let row = Row { way, together, seconds, rooms_an_hour: f64::from(a.runs) * 3600.0 / seconds };
            let name = match way {
                Way::Processes => "processes",
                Way::OneProcess => "one process",
            };
            println!("{together:>2} at a time, {name:<11} {seconds:>8.2} s {:>8.0} rooms an hour", row.rooms_an_hour);
            rows.push(row);
        }
    }
    println!("equal bits in all of them");
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let device = runs.device.info().name.clone();
    let answer = Answer { command: "rooms", device, cores, runs: a.runs, steps: a.steps, rows };
    match &common.json {
        Some(path) if path.as_os_str() == "-" => println!("{}", serde_json::to_string_pretty(&answer)?),
        Some(path) => {
            let text = serde_json::to_string_pretty(&answer)? + "\n";
            sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
        }
        None => {}
    }
    Ok(())
}

impl Runs<'_> {
    /// Trains `count` runs below a directory, several at a time.
    fn train(&self, way: Way, count: u32, together: u32, root: &Path) -> anyhow::Result<()> {
        let (next, errors) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
        std::thread::scope(|scope| {
            for _ in 0..together {
                scope.spawn(|| {
                    loop {
                        let i = next.fetch_add(1, Ordering::SeqCst);
                        if i >= count as usize {
                            break;
                        }
                        let trained = match way {
                            Way::Processes => self.process(i, root),
                            Way::OneProcess => self.thread(i, root),
                        };
                        if let Err(error) = trained {
                            errors.lock().unwrap_or_else(PoisonError::into_inner).push(error);
                            break;
                        }
                    }
                });
            }
        });
        match errors.into_inner().unwrap_or_else(PoisonError::into_inner).into_iter().next() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    fn of(&self, i: usize) -> (&(PathBuf, Arc<Scene>), u64) {
        (&self.scenes[i % self.scenes.len()], (i / self.scenes.len()) as u64)
    }

    fn process(&self, i: usize, root: &Path) -> anyhow::Result<()> {
        let ((path, _), seed) = self.of(i);
        let mut command = Command::new(&self.program);
        command.arg("train").arg(path).arg("-o").arg(root.join(i.to_string())).arg("--config").arg(&self.config);
        command.args(["--seed", &seed.to_string(), "-q"]).stdin(Stdio::null()).stdout(Stdio::null());
        if let Some(device) = &self.common.device {
            command.args(["--device", device]);
        }
        let output = command.output().with_context(|| format!("{} cannot be started", self.program.display()))?;
        if !output.status.success() {
            bail!("a training failed: {}", String::from_utf8_lossy(&output.stderr).trim());
        }
        Ok(())
    }

    fn thread(&self, i: usize, root: &Path) -> anyhow::Result<()> {
        let ((path, scene), seed) = self.of(i);
        let mut settings = Settings { seed, scene: path.clone(), ..self.settings.clone() };
        settings.exposure = scene.exposure();
        let run = Some(root.join(i.to_string()));
        let options = TrainerOptions { stages: vec![StageKind::Geometry], run, ..TrainerOptions::default() };
        let outcome = Trainer::new(&self.device, scene.clone(), &settings, options)?.run(&mut Silent)?;
        ensure!(outcome == Outcome::Finished, "a training stopped");
        Ok(())
    }
}

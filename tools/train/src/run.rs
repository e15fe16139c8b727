//! The run directory: what training leaves, and where.

use crate::error::{Result, TrainError};
use crate::kept::Kept;
use crate::settings::{Settings, one_line};
use serde::Serialize;
use sgs_passes::pipeline::{IntrinsicReport, StepReport};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The file with the semantic head of a run.
const SEMANTICS: &str = "semantics.safetensors";

/// What says that a stage has diverged.
const DIVERGED: &str = "diverged.json";

/// A run directory.
#[derive(Clone, Debug)]
pub struct RunDirectory {
    root: PathBuf,
}

/// One line of `log.jsonl`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StepLog {
    /// The step.
    pub step: u32,
    /// Weighted sum of all losses.
    pub loss: f32,
    /// Mean absolute difference.
    pub l1: f32,
    /// SSIM.
    pub ssim: f32,
    /// One minus the cosine to the normal prior.
    pub normal: f32,
    /// One minus the cosine to the semantic prior.
    pub semantic: f32,
    /// Cross-entropy of the classes.
    pub semantic_class: f32,
    /// Distance of a region's features between views.
    pub correspondence: f32,
    /// Cross-entropy of its class there.
    pub correspondence_class: f32,
    /// How many Gaussians.
    pub gaussians: u32,
    /// How many of them the view sees.
    pub visible: u32,
    /// Tile entries.
    pub entries: u32,
    /// Splats skipped so far because their gradients were not finite.
    pub skipped: u32,
    /// What returns to the last good state have multiplied learning rates by; absent where there were none.
    #[serde(skip_serializing_if = "is_one")]
    pub rates: f64,
}

/// One line of `log.jsonl` of the intrinsic stage. A loss that does not run has no key. Losses that not each step has are those of
/// the last step that had them.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct IntrinsicLog {
    /// `intrinsic`.
    pub stage: &'static str,
    /// The step.
    pub step: u32,
    /// Weighted loss of the shaded image.
    pub shaded: f32,
    /// Its mean absolute difference.
    pub l1: f32,
    /// Its SSIM.
    pub ssim: f32,
    /// Weighted photometric loss of albedo against the prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<f32>,
    /// The same of roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<f32>,
    /// The same of metallic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metallic: Option<f32>,
    /// Multi-scale gradient loss of albedo against the prior; this and all below before their weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo_gradients: Option<f32>,
    /// The same of roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness_gradients: Option<f32>,
    /// Edge-aware smoothness of albedo.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo_smooth: Option<f32>,
    /// The same of roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness_smooth: Option<f32>,
    /// Smoothness of the environment map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub environment_smooth: Option<f32>,
    /// Nearness of lights to surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_position: Option<f32>,
    /// Amplitudes of lights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_value: Option<f32>,
    /// Change of visibility under a jitter of points and lights, mean over pixels and lights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visibility_jitter: Option<f32>,
    /// L_cross_semantic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cross_view: Option<f32>,
    /// L_relight.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relight: Option<f32>,
    /// Albedo of a region against the view's own prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_prior: Option<f32>,
    /// Gradients skipped so far because they were not finite.
    pub skipped: u32,
    /// What returns to the last good state have multiplied learning rates by; absent where there were none.
    #[serde(skip_serializing_if = "is_one")]
    pub rates: f64,
}

/// Losses of the intrinsic stage that run in each step; the weight of the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoggedLosses {
    /// Albedo against the prior.
    pub albedo: bool,
    /// Roughness against the prior.
    pub roughness: bool,
    /// Metallic against the prior.
    pub metallic: bool,
    /// Gradients of albedo.
    pub albedo_gradients: bool,
    /// Gradients of roughness.
    pub roughness_gradients: bool,
    /// Smoothness of albedo.
    pub albedo_smooth: bool,
    /// Smoothness of roughness.
    pub roughness_smooth: bool,
    /// Smoothness of the environment map.
    pub environment_smooth: bool,
    /// Nearness of lights to surfaces.
    pub light_position: bool,
    /// Amplitudes of lights.
    pub light_value: bool,
    /// Weight of the visibility field's jitter; 0 where it does not run.
    pub visibility_jitter: f32,
}

impl IntrinsicLog {
    /// The line of a step.
    pub fn of(r: &IntrinsicReport, runs: &LoggedLosses, rates: f64) -> IntrinsicLog {
        let m = &r.materials;
        let seen = |value: f32| (value >= 0.0).then_some(value);
        IntrinsicLog {
            stage: "intrinsic",
            step: r.step,
            shaded: r.shaded,
            l1: r.shaded_l1,
            ssim: r.shaded_ssim,
            albedo: runs.albedo.then_some(r.albedo),
            roughness: runs.roughness.then_some(r.roughness),
            metallic: runs.metallic.then_some(r.metallic),
            albedo_gradients: runs.albedo_gradients.then_some(m.albedo_msg),
            roughness_gradients: runs.roughness_gradients.then_some(m.roughness_msg),
            albedo_smooth: runs.albedo_smooth.then_some(m.albedo_edge),
            roughness_smooth: runs.roughness_smooth.then_some(m.roughness_edge),
            environment_smooth: runs.environment_smooth.then_some(r.environment_smooth),
            light_position: runs.light_position.then_some(r.light_position),
            light_value: runs.light_value.then_some(r.light_value),
            visibility_jitter: (runs.visibility_jitter > 0.0).then(|| r.visibility_jitter / runs.visibility_jitter),
            cross_view: seen(r.recent_cross_view),
            relight: seen(r.recent_relight),
            own_prior: seen(r.recent_own_prior),
            skipped: r.skipped,
            rates,
        }
    }
}

impl From<&StepReport> for StepLog {
    fn from(r: &StepReport) -> StepLog {
        StepLog {
            step: r.step,
            loss: r.losses.total,
            l1: r.losses.l1,
            ssim: r.losses.ssim,
            normal: r.losses.normal,
            semantic: r.losses.semantic,
            semantic_class: r.losses.semantic_class,
            correspondence: r.losses.correspondence,
            correspondence_class: r.losses.correspondence_class,
            gaussians: r.gaussians,
            visible: r.visible,
            entries: r.entries,
            skipped: r.skipped,
            rates: 1.0,
        }
    }
}

fn is_one(rates: &f64) -> bool {
    *rates == 1.0
}

impl RunDirectory {
    /// Makes the directory, or takes one that is there.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn create(root: &Path) -> Result<RunDirectory> {
        std::fs::create_dir_all(root.join("checkpoint")).map_err(|e| error(root, format!("cannot be made: {e}")))?;
        let run = RunDirectory { root: root.to_owned() };
        run.sweep();
        Ok(run)
    }

    /// Opens an existing run.
    ///
    /// # Errors
    /// If it is not a run directory.
    pub fn open(root: &Path) -> Result<RunDirectory> {
        if !root.join("config.toml").is_file() {
            return Err(error(root, "is not a run directory: there is no config.toml in it".into()));
        }
        Ok(RunDirectory { root: root.to_owned() })
    }

    /// The directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// A file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// The resumable state.
    pub fn checkpoint(&self) -> PathBuf {
        self.root.join("checkpoint").join("geometry.safetensors")
    }

    /// The resumable state of the intrinsic stage.
    pub fn intrinsic_checkpoint(&self) -> PathBuf {
        self.root.join("checkpoint").join("intrinsic.safetensors")
    }

    /// What the geometry stage may go back to.
    pub fn kept(&self) -> Kept {
        Kept::of(self.checkpoint())
    }

    /// What the intrinsic stage may go back to.
    pub fn intrinsic_kept(&self) -> Kept {
        Kept::of(self.intrinsic_checkpoint())
    }

    /// Says that a stage has diverged: until it is resumed, with other learning rates if one likes.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn set_diverged(&self, about: &impl Serialize) -> Result<()> {
        self.write_json(DIVERGED, about)
    }

    /// Whether a stage has diverged.
    pub fn has_diverged(&self) -> bool {
        self.path(DIVERGED).is_file()
    }

    /// Forgets that a stage has diverged.
    ///
    /// # Errors
    /// If the file cannot be removed.
    pub fn forget_diverged(&self) -> Result<()> {
        self.remove([self.path(DIVERGED)])
    }

    /// The settings it was trained with.
    ///
    /// # Errors
    /// If they cannot be read, or are none that training takes.
    pub fn settings(&self) -> Result<Settings> {
        let path = self.path("config.toml");
        let text = std::fs::read_to_string(&path).map_err(|e| error(&path, format!("cannot be read: {e}")))?;
        let table = text
            .parse()
            .map_err(|e: toml::de::Error| error(&path, format!("is not valid: {}", one_line(e.message()))))?;
        let settings = Settings::from_table(table).and_then(|settings| settings.check().map(|()| settings));
        settings.map_err(|e| error(&path, one_line(&e.to_string())))
    }

    /// Where the semantic head is, if the run has one ([`crate::SemanticHead`]).
    pub fn semantics(&self) -> PathBuf {
        self.path(SEMANTICS)
    }

    /// Removes what an earlier training left, so that nothing can be taken for a result of the one that begins.
    ///
    /// # Errors
    /// If something cannot be removed.
    pub fn forget(&self) -> Result<()> {
        let names = ["scene.ply", SEMANTICS, "log.jsonl", DIVERGED, "profile.json", "graph.html"];
        // The checkpoint goes first: were it left with other settings, resuming would go on from it. A summary that is damaged is
        // in nobody's way.
        self.remove([self.checkpoint(), self.path("training.json")])?;
        self.kept().forget()?;
        self.forget_intrinsic()?;
        self.remove(names.map(|n| self.path(n)))
    }

    /// Removes what an earlier intrinsic stage left.
    ///
    /// # Errors
    /// If something cannot be removed, or `training.json` is damaged.
    pub fn forget_intrinsic(&self) -> Result<()> {
        let results = ["lights.json", "environment.exr", "visibility.safetensors", "metrics.json"];
        let names = results.into_iter().chain(["profile-intrinsic.json", "graph-intrinsic.html"]);
        self.remove(std::iter::once(self.intrinsic_checkpoint()).chain(names.map(|n| self.path(n))))?;
        self.intrinsic_kept().forget()?;
        // What the geometry came to stays known.
        let serde_json::Value::Object(mut all) = self.training_summary()? else { return Ok(()) };
        if all.remove("intrinsic").is_none() {
            return Ok(());
        }
        if all.is_empty() { self.remove([self.path("training.json")]) } else { self.write_json("training.json", &all) }
    }

    fn remove(&self, paths: impl IntoIterator<Item = PathBuf>) -> Result<()> {
        paths.into_iter().try_for_each(|path| remove(&path))
    }

    /// Removes files that a killed training had begun to write. They are incomplete, and only take up room.
    fn sweep(&self) {
        for folder in [self.root.clone(), self.root.join("checkpoint")] {
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let name = entry.file_name();
                let name = name.to_string_lossy();
                if name.starts_with('.') && name.ends_with(".tmp") {
                    // One that stays does no harm.
                    let _ = std::fs::remove_file(entry.path());
                }
            }
        }
    }

    /// Writes the settings.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_settings(&self, settings: &Settings) -> Result<()> {
        let path = self.path("config.toml");
        let text = toml::to_string(settings).map_err(|e| error(&path, e.to_string()))?;
        self.write(&path, text.as_bytes())
    }

    /// Writes something as JSON.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let path = self.path(name);
        let text = serde_json::to_string_pretty(value).map_err(|e| error(&path, e.to_string()))?;
        self.write(&path, text.as_bytes())
    }

    /// `training.json`, or null where there is none.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn training_summary(&self) -> Result<serde_json::Value> {
        let path = self.path("training.json");
        match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text).map_err(|e| error(&path, format!("is not valid: {e}"))),
            Err(_) => Ok(serde_json::Value::Null),
        }
    }

    /// Puts what the intrinsic stage came to into `training.json`.
    ///
    /// # Errors
    /// If the file is damaged or cannot be written.
    pub fn add_intrinsic_summary(&self, summary: &impl Serialize) -> Result<()> {
        let path = self.path("training.json");
        let mut all = match self.training_summary()? {
            serde_json::Value::Object(all) => all,
            _ => serde_json::Map::new(),
        };
        let value = serde_json::to_value(summary).map_err(|e| error(&path, e.to_string()))?;
        all.insert("intrinsic".to_owned(), value);
        self.write_json("training.json", &all)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> Result<()> {
        Ok(sgs_scene::atomic_write(path, |f| f.write_all(bytes))?)
    }

    /// Opens the log of the geometry stage; lines after `step` (of an interrupted run) and of later stages are dropped.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn log(&self, step: u32) -> Result<File> {
        self.log_of(|stage, s| stage.is_none() && s <= u64::from(step))
    }

    /// Opens the log of the intrinsic stage, whose lines say so; those of it after `step` are dropped.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn intrinsic_log(&self, step: u32) -> Result<File> {
        self.log_of(|stage, s| stage.is_none() || s <= u64::from(step))
    }

    fn log_of(&self, keep: impl Fn(Option<&str>, u64) -> bool) -> Result<File> {
        let path = self.path("log.jsonl");
        let kept: String = std::fs::read_to_string(&path)
            .unwrap_or_default()
            .lines()
            .filter(|l| {
                let value: Option<serde_json::Value> = serde_json::from_str(l).ok();
                value.is_some_and(|v| v["step"].as_u64().is_some_and(|s| keep(v["stage"].as_str(), s)))
            })
            .map(|l| format!("{l}\n"))
            .collect();
        self.write(&path, kept.as_bytes())?;
        File::options().append(true).open(&path).map_err(|e| error(&path, format!("cannot be written: {e}")))
    }
}

pub(crate) fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(error(path, format!("cannot be removed: {e}"))),
        _ => Ok(()),
    }
}

pub(crate) fn error(path: &Path, reason: String) -> TrainError {
    TrainError::File { path: path.to_owned(), reason }
}

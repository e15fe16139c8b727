//! Layout and files of a run directory.

use crate::error::{Result, RunError, error, io_error, remove};
use crate::rollback::RollbackFiles;
use crate::stage::StageKind;
use serde::Serialize;
use sgs_config::{Settings, one_line};
use sgs_scene::Splats;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Name of the file with the semantic head.
const SEMANTICS: &str = "semantics.safetensors";

/// Name of the file with the emitters.
const EMITTERS: &str = "emitters.json";

/// Name of the file that marks a diverged stage.
const DIVERGED: &str = "diverged.json";

/// Run directory.
#[derive(Clone, Debug)]
pub struct RunDirectory {
    root: PathBuf,
}

impl RunDirectory {
    /// Creates the directory, or uses an existing one.
    ///
    /// # Errors
    /// If the directory cannot be created.
    pub fn create(root: &Path) -> Result<RunDirectory> {
        std::fs::create_dir_all(root.join("checkpoint")).map_err(io_error("made", root))?;
        let run = RunDirectory { root: root.to_owned() };
        run.sweep();
        Ok(run)
    }

    /// Opens an existing run.
    ///
    /// # Errors
    /// If the directory is not a run directory.
    pub fn open(root: &Path) -> Result<RunDirectory> {
        if !root.join("config.toml").is_file() {
            return Err(error(root, "is not a run directory: there is no config.toml in it".into()));
        }
        Ok(RunDirectory { root: root.to_owned() })
    }

    /// Returns the path of the directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the path of a file in the directory.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Returns the path of a stage's checkpoint.
    pub fn checkpoint(&self, stage: StageKind) -> PathBuf {
        self.root.join("checkpoint").join(format!("{stage}.safetensors"))
    }

    /// Returns the rollback checkpoints of a stage.
    pub fn rollback_files(&self, stage: StageKind) -> RollbackFiles {
        RollbackFiles::beside(self.checkpoint(stage))
    }

    /// Returns the path of a stage's profile: its last step as a Chrome trace.
    pub fn profile(&self, stage: StageKind) -> PathBuf {
        self.path(match stage {
            StageKind::Geometry => "profile.json",
            StageKind::Intrinsic => "profile-intrinsic.json",
            StageKind::Transport => "profile-transport.json",
        })
    }

    /// Returns the path of a stage's graph as an HTML page.
    pub fn graph(&self, stage: StageKind) -> PathBuf {
        self.path(match stage {
            StageKind::Geometry => "graph.html",
            StageKind::Intrinsic => "graph-intrinsic.html",
            StageKind::Transport => "graph-transport.html",
        })
    }

    /// Returns the stages that the run's summary reports as complete.
    ///
    /// A diverged run and a run without `scene.ply` have none.
    pub fn complete(&self, settings: &Settings) -> Vec<StageKind> {
        let summary = self.training_summary().unwrap_or_default();
        if !self.path("scene.ply").is_file() || self.has_diverged() {
            return Vec::new();
        }
        let wanted = [
            (StageKind::Geometry, &summary, settings.geometry.steps),
            (StageKind::Intrinsic, &summary["intrinsic"], settings.intrinsic.steps),
            (StageKind::Transport, &summary["transport"], settings.transport.steps.saturating_add(1)),
        ];
        let whole = wanted.into_iter().filter(|(_, of, steps)| of["steps"].as_u64() == Some(u64::from(*steps)));
        whole.map(|(stage, ..)| stage).collect()
    }

    /// Refuses to continue the geometry stage of a run with materials.
    ///
    /// Materials belong to the geometry on which they were trained.
    ///
    /// # Errors
    /// If the run has materials.
    pub fn check_without_materials(&self) -> Result<()> {
        let scene = self.path("scene.ply");
        let painted = || scene.is_file() && Splats::read_ply(&scene).is_ok_and(|s| s.albedo.is_some());
        if self.checkpoint(StageKind::Intrinsic).is_file() || painted() {
            return Err(RunError::Refused(format!(
                "\"{}\" has got to materials, which its geometry must not change under: resume it with --stage intrinsic, or \
                 train geometry into another directory.",
                self.root.display()
            )));
        }
        Ok(())
    }

    /// Marks a stage as diverged until it is resumed.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn set_diverged(&self, about: &impl Serialize) -> Result<()> {
        self.write_json(DIVERGED, about)
    }

    /// Returns whether a stage has diverged.
    pub fn has_diverged(&self) -> bool {
        self.path(DIVERGED).is_file()
    }

    /// Removes the mark of a diverged stage.
    ///
    /// # Errors
    /// If the file cannot be removed.
    pub fn forget_diverged(&self) -> Result<()> {
        self.remove([self.path(DIVERGED)])
    }

    /// Returns the settings with which the run was trained.
    ///
    /// # Errors
    /// If the settings cannot be read or are invalid.
    pub fn settings(&self) -> Result<Settings> {
        let path = self.path("config.toml");
        let text = std::fs::read_to_string(&path).map_err(|e| error(&path, format!("cannot be read: {e}")))?;
        let table = text
            .parse()
            .map_err(|e: toml::de::Error| error(&path, format!("is not valid: {}", one_line(e.message()))))?;
        let settings = Settings::from_table(table).and_then(|settings| settings.check().map(|()| settings));
        settings.map_err(|e| error(&path, one_line(&e.to_string())))
    }

    /// Returns the path of the semantic head ([`crate::SemanticHead`]).
    ///
    /// Not every run has this file.
    pub fn semantics(&self) -> PathBuf {
        self.path(SEMANTICS)
    }

    /// Returns the path of the emitters ([`crate::EmitterFile`]).
    ///
    /// Only the transport stage writes this file.
    pub fn emitters(&self) -> PathBuf {
        self.path(EMITTERS)
    }

    /// Removes all results of an earlier training.
    ///
    /// No stale file can be mistaken for a result of the new training.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn forget(&self) -> Result<()> {
        let names = ["scene.ply", SEMANTICS, "log.jsonl", DIVERGED, "profile.json", "graph.html"];
        // The checkpoint goes first: otherwise a resumed training could continue from it with other settings.
        // `training.json` goes before `forget_intrinsic`, which fails if it is damaged.
        self.remove([self.checkpoint(StageKind::Geometry), self.path("training.json")])?;
        self.rollback_files(StageKind::Geometry).remove()?;
        self.forget_intrinsic()?;
        self.remove(names.map(|n| self.path(n)))?;
        self.write_learned_views(None)
    }

    /// Removes the results of the intrinsic stage and of the stage after it.
    ///
    /// # Errors
    /// If a file cannot be removed, or `training.json` is damaged.
    pub fn forget_intrinsic(&self) -> Result<()> {
        let results = ["lights.json", "environment.exr", "visibility.safetensors", "metrics.json"];
        self.forget_stage(StageKind::Intrinsic, &results)?;
        self.forget_transport()
    }

    /// Removes the results of an earlier transport stage. `scene.ply` keeps its emitters.
    ///
    /// # Errors
    /// If a file cannot be removed, or `training.json` is damaged.
    pub fn forget_transport(&self) -> Result<()> {
        self.forget_stage(StageKind::Transport, &[EMITTERS, "metrics.json"])
    }

    /// Removes files of a stage after the first, and its part of `training.json`.
    fn forget_stage(&self, stage: StageKind, results: &[&str]) -> Result<()> {
        let own = [self.checkpoint(stage), self.profile(stage), self.graph(stage)];
        self.remove(own.into_iter().chain(results.iter().map(|n| self.path(n))))?;
        self.rollback_files(stage).remove()?;
        // The summaries of the other stages remain.
        let serde_json::Value::Object(mut all) = self.training_summary()? else { return Ok(()) };
        if all.remove(stage.name()).is_none() {
            return Ok(());
        }
        if all.is_empty() { self.remove([self.path("training.json")]) } else { self.write_json("training.json", &all) }
    }

    pub(crate) fn remove(&self, paths: impl IntoIterator<Item = PathBuf>) -> Result<()> {
        paths.into_iter().try_for_each(|path| remove(&path))
    }

    /// Removes incomplete files of a killed training, which only take up space.
    fn sweep(&self) {
        for folder in [self.root.clone(), self.root.join("checkpoint")] {
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let name = entry.file_name();
                let name = name.to_string_lossy();
                if name.starts_with('.') && name.ends_with(".tmp") {
                    // A file that cannot be removed is harmless.
                    let _ = std::fs::remove_file(entry.path());
                }
            }
        }
    }

    /// Writes the settings to `config.toml`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_settings(&self, settings: &Settings) -> Result<()> {
        let path = self.path("config.toml");
        let text = toml::to_string(settings).map_err(|e| error(&path, e.to_string()))?;
        self.write(&path, text.as_bytes())
    }

    /// Writes a value as JSON.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let path = self.path(name);
        let text = serde_json::to_string_pretty(value).map_err(|e| error(&path, e.to_string()))?;
        self.write(&path, text.as_bytes())
    }

    /// Reads `training.json`; null if the file does not exist.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn training_summary(&self) -> Result<serde_json::Value> {
        let path = self.path("training.json");
        match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text).map_err(|e| error(&path, format!("is not valid: {e}"))),
            Err(_) => Ok(serde_json::Value::Null),
        }
    }

    /// Writes the summary of a stage into `training.json`.
    ///
    /// Summaries of later stages are added to that of the geometry stage. A new summary of the geometry stage replaces
    /// all.
    ///
    /// # Errors
    /// If the file is damaged or cannot be written.
    pub fn write_summary(&self, stage: StageKind, summary: &impl Serialize) -> Result<()> {
        if stage == StageKind::Geometry {
            return self.write_json("training.json", summary);
        }
        let path = self.path("training.json");
        let mut all = match self.training_summary()? {
            serde_json::Value::Object(all) => all,
            _ => serde_json::Map::new(),
        };
        let value = serde_json::to_value(summary).map_err(|e| error(&path, e.to_string()))?;
        all.insert(stage.name().to_owned(), value);
        self.write_json("training.json", &all)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> Result<()> {
        Ok(sgs_scene::atomic_write(path, |f| f.write_all(bytes))?)
    }

    /// Opens `log.jsonl` for a stage that continues after `step`.
    ///
    /// Drops lines after that step, and lines of later stages.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn open_log(&self, stage: StageKind, step: u32) -> Result<File> {
        let until = u64::from(step);
        // Lines of the geometry stage name no stage.
        let keep = |name: Option<&str>, at: u64| {
            let of = name.map_or(Some(StageKind::Geometry), StageKind::find);
            of.is_some_and(|of| of < stage || of == stage && at <= until)
        };
        let path = self.path("log.jsonl");
        let lines: String = std::fs::read_to_string(&path)
            .unwrap_or_default()
            .lines()
            .filter(|l| {
                let value: Option<serde_json::Value> = serde_json::from_str(l).ok();
                value.is_some_and(|v| v["step"].as_u64().is_some_and(|s| keep(v["stage"].as_str(), s)))
            })
            .map(|l| format!("{l}\n"))
            .collect();
        self.write(&path, lines.as_bytes())?;
        File::options().append(true).open(&path).map_err(io_error("written", &path))
    }
}

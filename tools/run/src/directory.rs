//! The run directory: what training leaves, and where.

use crate::error::{Result, RunError, error, remove};
use crate::rollback::RollbackFiles;
use crate::stage::StageKind;
use serde::Serialize;
use sgs_config::{Settings, one_line};
use sgs_scene::Splats;
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

    /// The checkpoint of a stage.
    pub fn checkpoint(&self, stage: StageKind) -> PathBuf {
        self.root.join("checkpoint").join(format!("{stage}.safetensors"))
    }

    /// The rollback checkpoints of a stage.
    pub fn rollback_files(&self, stage: StageKind) -> RollbackFiles {
        RollbackFiles::beside(self.checkpoint(stage))
    }

    /// The last step of a stage as a Chrome trace.
    pub fn profile(&self, stage: StageKind) -> PathBuf {
        self.path(match stage {
            StageKind::Geometry => "profile.json",
            StageKind::Intrinsic => "profile-intrinsic.json",
        })
    }

    /// The graph of a stage as a page.
    pub fn graph(&self, stage: StageKind) -> PathBuf {
        self.path(match stage {
            StageKind::Geometry => "graph.html",
            StageKind::Intrinsic => "graph-intrinsic.html",
        })
    }

    /// The stages whose steps are all finished, by the run's own summary.
    pub fn complete(&self, settings: &Settings) -> Vec<StageKind> {
        let summary = self.training_summary().unwrap_or_default();
        if !self.path("scene.ply").is_file() || self.has_diverged() {
            return Vec::new();
        }
        let wanted = [
            (StageKind::Geometry, &summary, settings.geometry.steps),
            (StageKind::Intrinsic, &summary["intrinsic"], settings.intrinsic.steps),
        ];
        let whole = wanted.into_iter().filter(|(_, of, steps)| of["steps"].as_u64() == Some(u64::from(*steps)));
        whole.map(|(stage, ..)| stage).collect()
    }

    /// Refuses to train geometry further under materials: they belong to the geometry as it is.
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
        self.remove([self.checkpoint(StageKind::Geometry), self.path("training.json")])?;
        self.rollback_files(StageKind::Geometry).remove()?;
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
        self.remove(std::iter::once(self.checkpoint(StageKind::Intrinsic)).chain(names.map(|n| self.path(n))))?;
        self.rollback_files(StageKind::Intrinsic).remove()?;
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

    /// Writes the summary of a stage into `training.json`. A later stage keeps the summaries of earlier ones.
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

    /// Opens `log.jsonl` for a stage that continues after `step`. Drops lines after that step, and lines of later stages.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn open_log(&self, stage: StageKind, step: u32) -> Result<File> {
        let until = u64::from(step);
        match stage {
            StageKind::Geometry => self.log_of(|line, s| line.is_none() && s <= until),
            StageKind::Intrinsic => self.log_of(|line, s| line.is_none() || s <= until),
        }
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

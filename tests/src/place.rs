//! Temporary directory with a tiny room and its runs, deleted on drop.

use crate::cli::{Finished, sgs, signal, start, until, wait};
use crate::rooms::Room;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Reads every file below a directory; returns an empty map if the directory is absent.
pub fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.path() {
            path if path.is_dir() => found.extend(files(&path)),
            path => drop(found.insert(path.clone(), std::fs::read(&path).unwrap())),
        }
    }
    found
}

/// Temporary directory with a room in `scene`, and runs next to the room.
pub struct Place(TempDir);

impl Place {
    /// Writes a room into a new temporary directory.
    pub fn new(room: Room) -> Place {
        let place = Place(tempfile::tempdir().unwrap());
        std::fs::create_dir(place.path("scene")).unwrap();
        room.write(&place.path("scene"));
        place
    }

    /// Returns the path of a file or directory in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Returns the path as a command-line argument.
    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Returns arguments of a training into `run`, with early densification.
    ///
    /// Densification starts at step 5 and repeats every 5 steps, until four fifths of the steps. Opacities are reset every
    /// 12 steps and checkpoints are written every 7.
    pub fn arguments(&self, run: &str, steps: u32, more: &[&str]) -> Vec<String> {
        let mut all: Vec<String> = ["train", &self.text("scene"), "-o", &self.text(run)].map(String::from).to_vec();
        all.extend(["--geometry-steps".into(), steps.to_string()]);
        for pair in [
            "geometry.densify.from=5",
            "geometry.densify.interval=5",
            "geometry.densify.until=0.8",
            "geometry.densify.reset_interval=12",
            "geometry.densify.grad_threshold=0.00005",
            "geometry.densify.max_gaussians=3000",
            "train.checkpoint_interval=7",
        ] {
            all.extend(["--set".into(), pair.into()]);
        }
        all.extend(more.iter().map(|s| (*s).to_owned()));
        all
    }

    /// Trains into `run`, killed after each of these steps and resumed.
    ///
    /// # Panics
    /// If the training ends before it is killed, or fails.
    pub fn train_killed(&self, run: &str, steps: u32, more: &[&str], after: &[u64]) {
        let mut child = start(&self.arguments(run, steps, more));
        for step in after {
            assert!(until(&mut child, || self.logged(run).last() >= Some(step)), "it ended before it was killed");
            signal(&child, "KILL");
            assert_eq!(wait(child).status, None);
            child = start(&["train", &self.text("scene"), "-o", &self.text(run), "--resume"]);
        }
        wait(child).ok();
    }

    /// Resumes the training into `run`.
    pub fn resume(&self, run: &str) -> Finished {
        sgs(&["train", &self.text("scene"), "-o", &self.text(run), "--resume"])
    }

    /// Reads a whole file.
    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Returns the steps in the log of a run, without decisions and densifications.
    ///
    /// # Panics
    /// If a line is not JSON.
    pub fn logged(&self, run: &str) -> Vec<u64> {
        let text = std::fs::read_to_string(self.path(run).join("log.jsonl")).unwrap_or_default();
        // A running training may have written only a part of the last line.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let lines =
            whole.lines().map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap_or_else(|e| panic!("{e}: {l}")));
        let steps = lines.filter(|l| l.get("decision").is_none() && l.get("densified").is_none());
        steps.map(|l| l["step"].as_u64().unwrap()).collect()
    }

    /// Fails unless two runs have equal `scene.ply` and `log.jsonl` files.
    #[track_caller]
    pub fn assert_same(&self, a: &str, b: &str) {
        for file in ["scene.ply", "log.jsonl"] {
            let (x, y) = (self.read(&format!("{a}/{file}")), self.read(&format!("{b}/{file}")));
            assert!(x == y, "{file} of {a} and {b} differ");
        }
    }
}

//! A folder with a tiny room and runs beside it, gone with the value.

use crate::cli::{Finished, sgs};
use crate::rooms::Room;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Reads every file below a folder; none where the folder is absent.
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

/// A folder with a room in `scene`, and runs beside it.
pub struct Place(TempDir);

impl Place {
    /// A room of its own.
    pub fn new(room: Room) -> Place {
        let place = Place(tempfile::tempdir().unwrap());
        std::fs::create_dir(place.path("scene")).unwrap();
        room.write(&place.path("scene"));
        place
    }

    /// A file or folder of it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The same as an argument.
    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Arguments of a training into `run`, with densification and resets in a few steps.
    pub fn arguments(&self, run: &str, steps: u32, more: &[&str]) -> Vec<String> {
        let mut all: Vec<String> = ["train", &self.text("scene"), "-o", &self.text(run)].map(String::from).to_vec();
        all.extend(["--geometry-steps".into(), steps.to_string()]);
        for pair in [
            "geometry.densify.from=5",
            "geometry.densify.interval=5",
            "geometry.densify.reset_interval=12",
            "geometry.densify.grad_threshold=0.00005",
            "geometry.densify.max_gaussians=3000",
            "geometry.entry_capacity=300",
            "geometry.checkpoint_interval=7",
        ] {
            all.extend(["--set".into(), pair.into()]);
        }
        all.extend(more.iter().map(|s| (*s).to_owned()));
        all
    }

    /// Goes on with the training into `run`.
    pub fn resume(&self, run: &str) -> Finished {
        sgs(&["train", &self.text("scene"), "-o", &self.text(run), "--resume"])
    }

    /// A file, whole.
    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// The steps in the log of a run, decisions and densifications left out; fails unless every line is JSON.
    pub fn logged(&self, run: &str) -> Vec<u64> {
        let text = std::fs::read_to_string(self.path(run).join("log.jsonl")).unwrap_or_default();
        // A line may be in the making while the run goes on.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let lines =
            whole.lines().map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap_or_else(|e| panic!("{e}: {l}")));
        let steps = lines.filter(|l| l.get("decision").is_none() && l.get("densified").is_none());
        steps.map(|l| l["step"].as_u64().unwrap()).collect()
    }

    /// Fails unless two runs left the same.
    #[track_caller]
    pub fn assert_same(&self, a: &str, b: &str) {
        for file in ["scene.ply", "log.jsonl"] {
            let (x, y) = (self.read(&format!("{a}/{file}")), self.read(&format!("{b}/{file}")));
            assert!(x == y, "{file} of {a} and {b} differ");
        }
    }
}

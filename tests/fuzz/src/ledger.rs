//! How long each target has been fed, over as many runs as it takes: a file that adds up.
//!
//! Promises: the file is whole at any time, and what a run that was stopped had finished is in it. Time is the processor's, with that of
//! processes a target starts, so that a busy machine does not count.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What a target was fed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fed {
    /// Seconds of the processor.
    pub seconds: f64,
    /// Those of them in which the program counted branches, and followed inputs that took new ones.
    #[serde(default)]
    pub guided: f64,
    /// Seconds of the clock on the wall: more where a target waits.
    pub wall: f64,
    /// Inputs that were tried.
    pub inputs: u64,
    /// Processes that did it, each with a seed of its own.
    pub slices: u64,
    /// Branches that the inputs of a slice took, at most.
    #[serde(default)]
    pub branches: u64,
    /// The most memory that an input took, bytes.
    pub most_memory: u64,
    /// What was found wrong.
    pub findings: u64,
}

impl Fed {
    /// With another slice.
    pub fn add(&mut self, slice: &Fed) {
        self.seconds = tenths(self.seconds + slice.seconds);
        self.guided = tenths(self.guided + slice.guided);
        self.wall = tenths(self.wall + slice.wall);
        self.inputs += slice.inputs;
        self.slices += slice.slices;
        self.branches = self.branches.max(slice.branches);
        self.most_memory = self.most_memory.max(slice.most_memory);
        self.findings += slice.findings;
    }
}

fn tenths(seconds: f64) -> f64 {
    (seconds * 10.0).round() / 10.0
}

/// All targets.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Ledger(BTreeMap<String, Fed>);

impl Ledger {
    /// What the file says; nothing if there is none.
    pub fn open(file: &Path) -> Result<Ledger, String> {
        match std::fs::read_to_string(file) {
            Ok(text) => toml::from_str(&text).map_err(|e| format!("{}: {e}", file.display())),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Ledger::default()),
            Err(e) => Err(format!("{}: {e}", file.display())),
        }
    }

    /// Puts it where a reader finds the old file or the new one.
    pub fn write(&self, file: &Path) -> Result<(), String> {
        let failed = |e: &dyn std::fmt::Display| format!("{}: {e}", file.display());
        let text = toml::to_string(self).map_err(|e| failed(&e))?;
        sgs_scene::atomic_write(file, |out| std::io::Write::write_all(out, text.as_bytes())).map_err(|e| failed(&e))
    }

    /// What a target was fed.
    pub fn of(&self, target: &str) -> Fed {
        self.0.get(target).cloned().unwrap_or_default()
    }

    /// The target that was fed least, of those that were fed for less than `seconds` and for which `free` holds.
    pub fn hungriest<'a>(
        &self,
        targets: impl Iterator<Item = &'a str>,
        seconds: f64,
        free: impl Fn(&str) -> bool,
    ) -> Option<&'a str> {
        let hungry = targets.filter(|t| self.of(t).seconds < seconds && free(t));
        hungry.min_by(|a, b| self.of(a).seconds.total_cmp(&self.of(b).seconds))
    }

    /// Adds what a slice came to.
    pub fn add(&mut self, target: &str, slice: &Fed) {
        self.0.entry(target.to_owned()).or_default().add(slice);
    }
}

#[cfg(test)]
mod tests {
    use super::{Fed, Ledger};

    #[test]
    fn it_adds_up_and_lasts() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("ledger.toml");
        let mut ledger = Ledger::open(&file).expect("nothing is a ledger");
        let one = Fed { wall: 60.0, inputs: 7, slices: 1, most_memory: 9, ..Fed::default() };
        let slice = Fed { seconds: 40.04, guided: 40.04, branches: 300, ..one };
        ledger.add("gltf", &slice);
        ledger.add("gltf", &Fed { findings: 1, guided: 0.0, branches: 0, ..slice.clone() });
        ledger.add("lights", &Fed { seconds: 90.0, ..slice });
        ledger.write(&file).expect("it is written");
        let again = Ledger::open(&file).expect("it is read");
        assert_eq!(again, ledger);
        let both = Fed { wall: 120.0, inputs: 14, slices: 2, most_memory: 9, findings: 1, ..Fed::default() };
        assert_eq!(again.of("gltf"), Fed { seconds: 80.0, guided: 40.0, branches: 300, ..both });
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1, "nothing lies beside it");
        let before = "[gltf]\nseconds = 2.0\nwall = 3.0\ninputs = 4\nslices = 1\nmost_memory = 5\nfindings = 0\n";
        std::fs::write(&file, before).expect("written");
        let old = Ledger::open(&file).expect("ledgers from before branches were counted are read");
        assert_eq!((old.of("gltf").seconds, old.of("gltf").guided, old.of("gltf").branches), (2.0, 0.0, 0));
        std::fs::write(&file, "[gltf]\nhours = 3\n").expect("written");
        assert!(Ledger::open(&file).is_err_and(|e| e.contains("ledger.toml") && e.contains("hours")));
    }

    #[test]
    fn those_that_were_fed_least_come_first() {
        let mut ledger = Ledger::default();
        for (target, seconds) in [("a", 50.0), ("b", 20.0), ("c", 60.0)] {
            ledger.add(target, &Fed { seconds, ..Fed::default() });
        }
        let all = ["a", "b", "c", "d"];
        let next =
            |seconds: f64, without: &[&str]| ledger.hungriest(all.into_iter(), seconds, |t| !without.contains(&t));
        assert_eq!(next(60.0, &[]), Some("d"));
        assert_eq!(next(60.0, &["d"]), Some("b"));
        assert_eq!(next(60.0, &["d", "b"]), Some("a"));
        assert_eq!(next(60.0, &["d", "b", "a"]), None, "c has had enough");
        assert_eq!(next(61.0, &["d", "b", "a"]), Some("c"));
    }
}

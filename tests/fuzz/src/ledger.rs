//! Ledger: a file that accumulates the fuzzing time of each target over many runs.
//!
//! Guarantees: the file is complete at any time. A run that is stopped has recorded its finished slices. Time is
//! processor time, including the processes that a target starts, so that a busy machine does not distort it.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Accumulated fuzzing results of a target.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fed {
    /// Processor time, in seconds.
    pub seconds: f64,
    /// Processor time with branch counters, in seconds.
    ///
    /// During this time, mutations build on inputs that took new branches.
    #[serde(default)]
    pub guided: f64,
    /// Wall time, in seconds; larger than the processor time if a target waits.
    pub wall: f64,
    /// Number of inputs.
    pub inputs: u64,
    /// Number of processes, each with its own seed.
    pub slices: u64,
    /// Largest number of branches that the inputs of a slice took.
    #[serde(default)]
    pub branches: u64,
    /// Largest memory of an input, in bytes.
    pub most_memory: u64,
    /// Number of findings.
    pub findings: u64,
}

impl Fed {
    /// Adds a slice.
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

/// Accumulated results of all targets.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Ledger(BTreeMap<String, Fed>);

impl Ledger {
    /// Reads the file; returns an empty ledger if there is none.
    pub fn open(file: &Path) -> Result<Ledger, String> {
        match std::fs::read_to_string(file) {
            Ok(text) => toml::from_str(&text).map_err(|e| format!("{}: {e}", file.display())),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Ledger::default()),
            Err(e) => Err(format!("{}: {e}", file.display())),
        }
    }

    /// Writes the file atomically: a reader finds either the old or the new file.
    pub fn write(&self, file: &Path) -> Result<(), String> {
        let failed = |e: &dyn std::fmt::Display| format!("{}: {e}", file.display());
        let text = toml::to_string(self).map_err(|e| failed(&e))?;
        sgs_scene::atomic_write(file, |out| std::io::Write::write_all(out, text.as_bytes())).map_err(|e| failed(&e))
    }

    /// Returns the accumulated results of a target.
    pub fn of(&self, target: &str) -> Fed {
        self.0.get(target).cloned().unwrap_or_default()
    }

    /// Returns the target with the least time.
    ///
    /// Considers only targets with less than `seconds` for which `free` holds.
    pub fn hungriest<'a>(
        &self,
        targets: impl Iterator<Item = &'a str>,
        seconds: f64,
        free: impl Fn(&str) -> bool,
    ) -> Option<&'a str> {
        let hungry = targets.filter(|t| self.of(t).seconds < seconds && free(t));
        hungry.min_by(|a, b| self.of(a).seconds.total_cmp(&self.of(b).seconds))
    }

    /// Adds the results of a slice to a target.
    pub fn add(&mut self, target: &str, slice: &Fed) {
        self.0.entry(target.to_owned()).or_default().add(slice);
    }
}

#[cfg(test)]
mod tests {
    use super::{Fed, Ledger};

    #[test]
    fn ledger_sums_slices_and_reloads() {
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
    fn least_fuzzed_target_comes_first() {
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

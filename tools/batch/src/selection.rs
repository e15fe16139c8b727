//! Selection of runs by their names.

use crate::batch::Batch;
use crate::manifest::{Manifest, name_of};
use std::path::Path;

impl Manifest {
    /// Leaves out the scenes of which no run is named, so that they are not read.
    ///
    /// # Errors
    /// A sentence that names the first name that no run has.
    pub fn select(&mut self, names: &[String]) -> Result<(), String> {
        let has = |name: &&String| {
            let parts: Vec<&str> = name.split('/').collect();
            let [scene, variant, seed] = parts[..] else { return false };
            self.scenes.iter().any(|path| is_scene(path, scene))
                && self.variants.iter().any(|v| v.name == variant)
                && self.seeds.iter().any(|s| format!("seed{s}") == seed)
        };
        if let Some(name) = names.iter().find(|name| !has(name)) {
            return Err(format!("the manifest has no run \"{name}\"; --list prints the names of its runs"));
        }
        self.scenes.retain(|path| names.iter().any(|n| n.split('/').next().is_some_and(|scene| is_scene(path, scene))));
        Ok(())
    }
}

fn is_scene(path: &Path, scene: &str) -> bool {
    name_of(path).is_some_and(|name| name == scene)
}

impl Batch {
    /// Leaves out the runs that are not named.
    pub fn select(&mut self, names: &[String]) {
        self.runs.retain(|run| names.contains(&run.name()));
    }
}

#[cfg(test)]
mod tests {
    use crate::batch::tests::{batch, run};
    use crate::manifest::{Manifest, Stage, Variant};
    use sgs_config::Settings;
    use std::path::PathBuf;

    #[test]
    fn only_scenes_of_named_runs_are_read() {
        let manifest = Manifest {
            scenes: vec![PathBuf::from("rooms/a"), PathBuf::from("rooms/b")],
            ignored: Vec::new(),
            variants: vec![Variant { name: "fast".into(), settings: Settings::default() }],
            seeds: vec![0, 10],
            stage: Stage::Geometry,
            evaluate: true,
            limits: batch(Vec::new()).limits,
        };
        let select = |names: &[&str]| {
            let mut selected = manifest.clone();
            let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
            selected.select(&names).map(|()| selected.scenes)
        };
        assert_eq!(select(&["b/fast/seed10", "b/fast/seed0"]), Ok(vec![PathBuf::from("rooms/b")]));
        for wrong in ["c/fast/seed0", "a/slow/seed0", "a/fast/seed1", "a/fast/seed", "a/fast", "", "a/fast/seed0/"] {
            let error = select(&["a/fast/seed0", wrong]).unwrap_err();
            assert!(error.contains(&format!("no run \"{wrong}\"")), "{error}");
        }
    }

    #[test]
    fn only_named_runs_stay() {
        let mut batch = batch(vec![run("a", 0), run("a", 1), run("b", 0)]);
        batch.select(&["b/fast/seed0".into(), "a/fast/seed1".into()]);
        let names: Vec<String> = batch.runs.iter().map(|r| r.name()).collect();
        assert_eq!(names, ["a/fast/seed1", "b/fast/seed0"]);
    }
}

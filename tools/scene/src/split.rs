//! Which views are trained on and which are held out.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use serde::Deserialize;

use crate::error::{Result, SceneError};
use crate::json::read_json;
use crate::reader::stem_of;

/// Without `split.json`, one view in this many is a test view, beginning with the first.
const TEST_EVERY: usize = 8;

/// Indices into a scene's views.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// Views to train on.
    pub train: Vec<usize>,
    /// Views to measure on, never trained on.
    pub test: Vec<usize>,
}

#[derive(Deserialize)]
struct File {
    train: Vec<String>,
    #[serde(default)]
    test: Vec<String>,
}

impl Split {
    /// Every 8th of `count` views is a test view, beginning with the first.
    pub fn every_eighth(count: usize) -> Self {
        let (test, train) = (0..count).partition(|i| i % TEST_EVERY == 0);
        Self { train, test }
    }

    /// The stems that `split.json` names.
    pub(crate) fn names(path: &Path) -> Result<HashSet<String>> {
        let file: File = read_json(path)?;
        Ok(file.train.iter().chain(&file.test).map(|name| stem_of(Path::new(name))).collect())
    }

    /// Reads `split.json`, whose names are stems of `views`. Names of `missing` frames are passed over: the frame was
    /// warned about already.
    pub(crate) fn read(path: &Path, views: &[&str], missing: &[String]) -> Result<Self> {
        let file: File = read_json(path)?;
        let indices: HashMap<&str, usize> = views.iter().enumerate().map(|(i, &name)| (name, i)).collect();
        let missing: HashSet<&str> = missing.iter().map(String::as_str).collect();
        let mut seen = HashSet::new();
        let mut resolve = |list: &[String], what: &str| {
            let mut found = Vec::with_capacity(list.len());
            for name in list {
                if !seen.insert(name.clone()) {
                    let problem = format!("the view \"{name}\" is named twice; a view is for training or for tests");
                    return Err(SceneError::split(path, problem));
                }
                // Some write file names for stems.
                let stem = stem_of(Path::new(name));
                if let Some(&index) = indices.get(name.as_str()).or_else(|| indices.get(stem.as_str())) {
                    found.push(index);
                } else if !missing.contains(name.as_str()) && !missing.contains(stem.as_str()) {
                    let problem = format!(
                        "the {what} view \"{name}\" is none of the scene's {} views; correct the name or remove it",
                        views.len()
                    );
                    return Err(SceneError::split(path, problem));
                }
            }
            Ok(found)
        };
        let split = Self { train: resolve(&file.train, "training")?, test: resolve(&file.test, "test")? };
        if split.train.is_empty() {
            let problem = "no training view is left; name at least one whose image exists under \"train\"";
            return Err(SceneError::split(path, problem));
        }
        Ok(split)
    }

    /// Keeps `count` training views, spread evenly from the first to the last. Returns whether there were enough.
    pub(crate) fn spread(&mut self, count: usize) -> bool {
        let n = self.train.len();
        if count >= n {
            return count == n;
        }
        let steps = count.saturating_sub(1).max(1);
        self.train = (0..count).map(|i| self.train[i * (n - 1) / steps]).collect();
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Result<Split, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("split.json");
        std::fs::write(&path, json).unwrap();
        Split::read(&path, &["a", "b", "c.0"], &["gone".into()]).map_err(|e| e.to_string())
    }

    #[test]
    fn every_eighth_view_is_a_test() {
        let split = Split::every_eighth(18);
        assert_eq!(split.test, [0, 8, 16]);
        assert_eq!(split.train.len(), 15);
        assert!(split.train.iter().all(|i| i % 8 != 0));
    }

    #[test]
    fn names_become_indices_in_the_order_of_the_file() {
        let split = read(r#"{"train": ["b", "gone", "a.png"], "test": ["c.0"]}"#).unwrap();
        assert_eq!(split, Split { train: vec![1, 0], test: vec![2] });
        assert_eq!(read(r#"{"train": ["b"]}"#).unwrap(), Split { train: vec![1], test: vec![] });
    }

    #[test]
    fn each_fault_has_its_sentence() {
        assert!(read("{").unwrap_err().contains("split.json, line 1, column 1"));
        assert!(read("{}").unwrap_err().contains("missing field `train`"));
        let unknown = read(r#"{"train": ["a", "z"]}"#).unwrap_err();
        assert!(unknown.contains("split.json: the training view \"z\" is none of the scene's 3 views"), "{unknown}");
        assert!(read(r#"{"train": ["a"], "test": ["z"]}"#).unwrap_err().contains("the test view \"z\""));
        assert!(read(r#"{"train": ["a"], "test": ["a"]}"#).unwrap_err().contains("\"a\" is named twice"));
        assert!(read(r#"{"train": ["gone"], "test": ["a"]}"#).unwrap_err().contains("no training view is left"));
    }

    #[test]
    fn views_are_spread_evenly() {
        let spread = |n: usize, count: usize| {
            let mut split = Split { train: (10..10 + n).collect(), test: vec![] };
            let enough = split.spread(count);
            (split.train, enough)
        };
        assert_eq!(spread(9, 3), (vec![10, 14, 18], true));
        assert_eq!(spread(10, 4), (vec![10, 13, 16, 19], true));
        assert_eq!(spread(5, 1), (vec![10], true));
        assert_eq!(spread(3, 3), (vec![10, 11, 12], true));
        assert_eq!(spread(3, 4), (vec![10, 11, 12], false));
        for n in 1..40 {
            for count in 1..=n {
                let (mut train, _) = spread(n, count);
                train.dedup();
                assert_eq!(train.len(), count);
            }
        }
    }
}

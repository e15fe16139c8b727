//! Split of the views into training and test views.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use serde::Deserialize;

use crate::error::{Result, SceneError};
use crate::image::stem_of;
use crate::json::read_json;
use crate::split_rule::SplitRule;

/// Interval of test views without `split.json`, from the first view on.
const TEST_EVERY: usize = 8;

/// Training and test views, as indices into a scene's views.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// Training views.
    pub train: Vec<usize>,
    /// Test views for evaluation; never trained on.
    pub test: Vec<usize>,
}

#[derive(Deserialize)]
struct File {
    train: Vec<String>,
    #[serde(default)]
    test: Vec<String>,
}

impl Split {
    /// Makes every 8th of `count` views a test view, beginning with the first.
    pub fn every_eighth(count: usize) -> Self {
        Self::every(TEST_EVERY, count)
    }

    /// Makes every `n`th of `count` views a test view, beginning with the first.
    pub fn every(n: usize, count: usize) -> Self {
        let (test, train) = (0..count).partition(|i| i % n.max(1) == 0);
        Self { train, test }
    }

    /// Makes `n` of `count` views test views, spread evenly. The positions go from the second view to the last but one
    /// and are rounded down. Returns `None` if `n` is 0 or there are fewer than `n + 2` views.
    pub fn linspace(n: usize, count: usize) -> Option<Self> {
        let steps = n.saturating_sub(1).max(1);
        let last = count.checked_sub(2).filter(|inner| n > 0 && *inner >= n)?;
        let test: Vec<usize> = (0..n).map(|i| 1 + i * (last - 1) / steps).collect();
        let train = (0..count).filter(|i| test.binary_search(i).is_err()).collect();
        Some(Self { train, test })
    }

    /// Splits views by a rule; returns `None` for [`SplitRule::Auto`].
    pub(crate) fn by_rule(rule: &SplitRule, root: &Path, views: &[&str], missing: &[String]) -> Result<Option<Self>> {
        let count = views.len();
        let split = match rule {
            SplitRule::Auto => return Ok(None),
            SplitRule::Every(n) => Self::every(*n, count),
            SplitRule::Linspace(n) => Self::linspace(*n, count).ok_or_else(|| {
                let least = n.saturating_add(2);
                let problem =
                    format!("the split {rule} needs at least {least} views, but there are {count}; hold out fewer");
                SceneError::split(root, problem)
            })?,
            SplitRule::File(path) => Self::read(path, views, missing)?,
        };
        if split.train.is_empty() {
            let problem =
                format!("the split {rule} leaves no training view of {count} views; add views or another split");
            return Err(SceneError::split(root, problem));
        }
        Ok(Some(split))
    }

    /// Returns the stems that a split file names.
    pub(crate) fn names(path: &Path) -> Result<HashSet<String>> {
        let file: File = read_json(path)?;
        Ok(file.train.iter().chain(&file.test).map(|name| stem_of(Path::new(name))).collect())
    }

    /// Reads `split.json`, whose names are stems of `views`. Names of `missing` frames are ignored, because readers
    /// already warn about them.
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
                // Some files contain file names instead of stems.
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

    /// Keeps `count` training views, spread evenly from the first to the last. Returns whether at least `count` views
    /// existed.
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
    fn every_eighth_view_is_a_test_view() {
        let split = Split::every_eighth(18);
        assert_eq!(split.test, [0, 8, 16]);
        assert_eq!(split.train.len(), 15);
        assert!(split.train.iter().all(|i| i % 8 != 0));
    }

    /// 24 views: numpy's `linspace(1, 22, 5)` is 1, 6.25, 11.5, 16.75, 22.
    #[test]
    fn linspace_holds_out_views_between_the_first_and_the_last() {
        let split = Split::linspace(5, 24).unwrap();
        assert_eq!(split.test, [1, 6, 11, 16, 22]);
        assert_eq!(split.train.len(), 19);
        assert!(split.train.iter().all(|i| !split.test.contains(i)));
        assert_eq!(Split::linspace(1, 9).unwrap().test, [1]);
        assert_eq!(Split::linspace(3, 5).unwrap(), Split { train: vec![0, 4], test: vec![1, 2, 3] });
        for (n, count) in [(0, 9), (4, 5), (1, 2), (1, 0)] {
            assert_eq!(Split::linspace(n, count), None, "{n} of {count}");
        }
        for n in 1..20 {
            let mut test = Split::linspace(n, n + 7).unwrap().test;
            test.dedup();
            assert!(test.len() == n && test[0] == 1 && *test.last().unwrap() <= n + 5);
        }
    }

    #[test]
    fn every_third_view_is_a_test_view() {
        assert_eq!(Split::every(3, 7), Split { train: vec![1, 2, 4, 5], test: vec![0, 3, 6] });
    }

    #[test]
    fn names_become_indices_in_file_order() {
        let split = read(r#"{"train": ["b", "gone", "a.png"], "test": ["c.0"]}"#).unwrap();
        assert_eq!(split, Split { train: vec![1, 0], test: vec![2] });
        assert_eq!(read(r#"{"train": ["b"]}"#).unwrap(), Split { train: vec![1], test: vec![] });
    }

    #[test]
    fn each_error_has_its_message() {
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

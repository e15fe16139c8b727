//! A checkpoint of the intrinsic stage as a file: what it says, before that is held against a stage.
//!
//! Promises: no device has a part in it; what no stage could have written is refused.

use super::automatic::Remembered;
use crate::course::{Course, json, wrong_moments};
use crate::decision::Decision;
use crate::error::error;
use crate::error::{Result, TrainError};
use safetensors::{Dtype, SafeTensors};
use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::path::Path;

/// What such a file calls itself.
pub(super) const FORMAT: &str = "sgs-intrinsic-1";

/// What steps have asked of the surroundings since these moved.
pub(super) const GATHERED: &str = "environment_gathered";

/// Tensors of what is said of views under other lights, and of the steps at which that was.
pub(super) const ESTIMATES: &str = "relit_estimates";
pub(super) const ASKED_AT: &str = "relit_asked_at";

/// What was decided about the model.
pub(super) const DECISIONS: &str = "decisions";

/// How many levels the visibility field has, where that may be decided.
pub(super) const LEVELS: &str = "levels";

/// How many texels surroundings have along an edge, where that may be decided.
pub(super) const TEXELS: &str = "texels";

/// Surroundings as they were after some step, which follows.
pub(super) const BEFORE: &str = "environment_after_";

/// How often surroundings move, where that may be decided: once in how many steps, since which step, and how often before.
pub(super) const PACE: &str = "pace";

/// The error of shaded pictures when they were last looked at.
pub(super) const LAST: &str = "last_look";

/// Losses that not each step has, as they were last: pseudo-views, other lights, own priors, smoothness of the environment.
pub(super) const RECENT: &str = "recent_losses";

/// How many lobes lights have, where that may be decided.
pub(super) const LOBES: &str = "lobes";

/// Tensors of the visibility field.
pub(super) const FIELD: [&str; 4] =
    ["visibility_tables", "visibility_mlp", "visibility_tables_moments", "visibility_mlp_moments"];

/// Gains of the lights.
pub(super) const GAINS: &str = "light_gains";

/// What a checkpoint says. Tensors are read when their sizes are known.
pub(crate) struct Saved<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
    /// After which step it was written.
    pub step: u32,
    /// Of how many splats it is.
    pub splats: u32,
    /// How the training goes.
    pub course: Course,
    /// What was decided about the model.
    pub decisions: Vec<Decision>,
    /// Lobes of a light, where they may be decided: from 1 to 32.
    pub lobes: Option<u32>,
    /// Levels of the visibility field, where they may be decided: from 1 on.
    pub levels: Option<u32>,
    /// Texels along an edge of surroundings, where they may be decided: a power of two from 16 on.
    pub texels: Option<u32>,
    /// Once in how many steps surroundings move, since which step, and how often before, where that may be decided.
    pub pace: Option<[u32; 3]>,
    /// The error of shaded pictures when they were last looked at.
    pub last: Option<f64>,
}

impl<'a> Saved<'a> {
    /// Reads what a file says.
    ///
    /// # Errors
    /// If it is damaged, or of something else.
    pub fn read(path: &'a Path, bytes: &'a [u8]) -> Result<Saved<'a>> {
        let refused = |reason: String| error(path, reason);
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| refused(format!("not a checkpoint: {e}")))?;
        let meta = header.metadata().clone().unwrap_or_default();
        if meta.get("format").map(String::as_str) != Some(FORMAT) {
            return Err(refused("not a checkpoint of the intrinsic stage".into()));
        }
        let number = |name: &str| -> Result<u32> {
            let value = meta.get(name).and_then(|s| s.parse().ok());
            value.ok_or_else(|| refused(format!("the checkpoint does not say its {name}")))
        };
        let (step, splats) = (number("step")?, number("splats")?);
        let tensors = SafeTensors::deserialize(bytes).map_err(|e| refused(format!("damaged: {e}")))?;
        let decisions: Vec<Decision> = json(path, &meta, DECISIONS)?.unwrap_or_default();
        if let Some(later) = decisions.iter().find(|d| d.step > step) {
            return Err(refused(format!("damaged: after step {step} nothing was decided at step {}", later.step)));
        }
        let within = |name: &str, range: RangeInclusive<u32>| -> Result<Option<u32>> {
            let Some(text) = meta.get(name) else { return Ok(None) };
            let value = text.parse().ok().filter(|n| range.contains(n));
            let wrong = || refused(format!("damaged: \"{text}\" is no number of {name}"));
            value.map(Some).ok_or_else(wrong)
        };
        let (lobes, levels) = (within(LOBES, 1..=32)?, within(LEVELS, 1..=u32::MAX)?);
        let texels = match meta.get(TEXELS) {
            None => None,
            Some(text) => {
                let size = text.parse().ok().filter(|n: &u32| n.is_power_of_two() && *n >= 16);
                Some(size.ok_or_else(|| no_texels(path, text))?)
            }
        };
        Ok(Saved {
            path,
            tensors,
            step,
            splats,
            course: Course::read(path, &meta)?,
            decisions,
            lobes,
            levels,
            texels,
            pace: pace(&meta, step).map_err(refused)?,
            last: last(&meta).map_err(refused)?,
        })
    }

    /// Whether there is a tensor of this name.
    pub fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// The values of a tensor.
    ///
    /// # Errors
    /// If there are not so many, or some are not finite.
    pub fn floats(&self, name: &str, count: usize) -> Result<Vec<f32>> {
        let data = self.data(name, count, Dtype::F32)?;
        let values: Vec<f32> = data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        match values.iter().all(|v| v.is_finite()) {
            true => Ok(values),
            false => Err(self.refused(format!("damaged: \"{name}\" holds values that are not finite"))),
        }
    }

    /// First and second moments of so many values, in pairs.
    ///
    /// # Errors
    /// If there are not so many, or some cannot be.
    pub fn moments(&self, name: &str, count: usize) -> Result<Vec<f32>> {
        let values = self.floats(name, 2 * count)?;
        match wrong_moments(&values) {
            None => Ok(values),
            Some(wrong) => Err(self.refused(format!("damaged: \"{name}\" holds {wrong}"))),
        }
    }

    /// The words of a tensor.
    ///
    /// # Errors
    /// If there are not so many.
    pub fn words(&self, name: &str, count: usize) -> Result<Vec<u32>> {
        let data = self.data(name, count, Dtype::U32)?;
        Ok(data.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect())
    }

    /// Before which step each of so many views was asked about under other lights; 0 is never.
    ///
    /// # Errors
    /// If there are not so many, or some are after the next step.
    pub fn asked_at(&self, views: usize) -> Result<Vec<u32>> {
        let steps = self.words(ASKED_AT, views)?;
        match steps.iter().find(|step| **step > self.step.saturating_add(1)) {
            None => Ok(steps),
            Some(later) => Err(self.refused(format!("damaged: \"{ASKED_AT}\" tells of step {later}"))),
        }
    }

    /// Surroundings as they were after earlier steps, by these, of so many values each.
    ///
    /// # Errors
    /// If some have another size, or are of no step that has been.
    pub fn before(&self, count: usize) -> Result<Vec<Remembered>> {
        let mut before = Vec::new();
        for name in self.tensors.names() {
            let Some(taken) = name.strip_prefix(BEFORE) else { continue };
            let taken = taken.parse().ok().filter(|taken| *taken <= self.step);
            let unknown = || self.refused(format!("damaged: \"{name}\" is of no step until {}", self.step));
            before.push((taken.ok_or_else(unknown)?, self.floats(name, count)?));
        }
        before.sort_by_key(|b| b.0);
        Ok(before)
    }

    /// An error about the file.
    pub fn refused(&self, reason: String) -> TrainError {
        error(self.path, reason)
    }

    /// That surroundings cannot have so many texels along an edge.
    pub fn no_texels(&self, size: u32) -> TrainError {
        no_texels(self.path, &size.to_string())
    }

    fn data(&self, name: &str, count: usize, kind: Dtype) -> Result<&'a [u8]> {
        let tensor = self.tensors.tensor(name);
        let tensor = tensor.map_err(|_| self.refused(format!("the checkpoint has no \"{name}\"")))?;
        if tensor.dtype() != kind || tensor.data().len() != 4 * count {
            let kind = if kind == Dtype::F32 { "floats" } else { "words" };
            return Err(self.refused(format!("\"{name}\" does not hold {count} 32-bit {kind}")));
        }
        Ok(tensor.data())
    }
}

/// How often surroundings move, until a step.
fn pace(meta: &HashMap<String, String>, step: u32) -> std::result::Result<Option<[u32; 3]>, String> {
    let Some(text) = meta.get(PACE) else { return Ok(None) };
    let numbers: Option<Vec<u32>> = text.split(' ').map(|n| n.parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[every @ 1..=64, since, moves]) if since <= step && moves <= since => Ok(Some([every, since, moves])),
        Some(&[1..=64, _, _]) => Err(format!("damaged: surroundings cannot move as in \"{text}\"")),
        _ => Err(format!("damaged: \"{text}\" does not say how often surroundings move")),
    }
}

/// The error when it was last looked at.
fn last(meta: &HashMap<String, String>) -> std::result::Result<Option<f64>, String> {
    let Some(text) = meta.get(LAST) else { return Ok(None) };
    let value = text.parse().ok().filter(|last: &f64| *last >= 0.0 && last.is_finite());
    value.map(Some).ok_or_else(|| format!("damaged: \"{text}\" is no error of pictures"))
}

fn no_texels(path: &Path, size: &str) -> TrainError {
    error(path, format!("damaged: surroundings cannot have \"{size}\" texels along an edge"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_run::{floats::Floats, floats::Numbers, floats::serialize};

    /// A file of a training of materials after 40 steps, with some of its metadata and tensors otherwise.
    fn bytes(meta: &[(&str, &str)], tensors: &[(&str, &[f32])]) -> Vec<u8> {
        let said = [
            ("format", FORMAT),
            ("step", "40"),
            ("splats", "1"),
            (LOBES, "6"),
            (LEVELS, "4"),
            (TEXELS, "16"),
            (PACE, "8 20 20"),
            (LAST, "0.5"),
        ];
        let held: [(&str, &[f32]); 4] = [
            ("albedo", &[0.25, -1.0, 2.0]),
            ("albedo_moments", &[0.0, 1.0, -1.0, 0.0, 3.0, 2.0]),
            ("environment_after_36", &[2.0; 3]),
            ("environment_after_40", &[1.0; 3]),
        ];
        let meta: HashMap<_, _> = said.iter().chain(meta).map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        let tensors: HashMap<_, _> = held.iter().chain(tensors).copied().collect();
        let floats = tensors.iter().map(|(name, v)| (*name, Numbers::Floats(Floats(v, vec![v.len()]))));
        let words = [(ASKED_AT, Numbers::Words(&[41, 0], vec![2]))];
        serialize(floats.chain(words), meta).unwrap()
    }

    #[test]
    fn what_is_whole_is_read() {
        let bytes = bytes(&[], &[]);
        let saved = Saved::read(Path::new("state"), &bytes).unwrap();
        assert_eq!((saved.step, saved.splats, saved.last, saved.decisions.len()), (40, 1, Some(0.5), 0));
        assert_eq!((saved.lobes, saved.levels, saved.texels), (Some(6), Some(4), Some(16)));
        assert_eq!((saved.pace, saved.course.roll_backs.len()), (Some([8, 20, 20]), 0));
        assert_eq!(saved.floats("albedo", 3).unwrap(), [0.25, -1.0, 2.0]);
        assert_eq!(saved.moments("albedo_moments", 3).unwrap(), [0.0, 1.0, -1.0, 0.0, 3.0, 2.0]);
        assert_eq!(saved.asked_at(2).unwrap(), [41, 0]);
        assert_eq!(saved.before(3).unwrap(), [(36, vec![2.0; 3]), (40, vec![1.0; 3])]);
        assert!(saved.has("albedo") && !saved.has("roughness"));
    }

    #[test]
    fn what_no_training_leaves_is_refused() {
        let path = Path::new("state");
        let refused = |meta: &[(&str, &str)], tensors: &[(&str, &[f32])]| -> String {
            let bytes = bytes(meta, tensors);
            let saved = match Saved::read(path, &bytes) {
                Ok(saved) => saved,
                Err(error) => return error.to_string(),
            };
            let values = [saved.floats("albedo", 3), saved.moments("albedo_moments", 3)];
            let errors = values.into_iter().filter_map(|v| v.err()).chain(saved.before(3).err());
            let errors = errors.chain(saved.asked_at(2).err());
            errors.map(|e| e.to_string()).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(refused(&[], &[]), "");
        for (name, value, what) in [
            ("format", "sgs-geometry-1", "not a checkpoint of the intrinsic stage"),
            ("step", "-1", "does not say its step"),
            ("step", "39", "tells of step 41"),
            ("splats", "", "does not say its splats"),
            (LOBES, "0", "\"0\" is no number of lobes"),
            (LOBES, "33", "\"33\" is no number of lobes"),
            (LEVELS, "x", "\"x\" is no number of levels"),
            (TEXELS, "8", "cannot have \"8\" texels"),
            (TEXELS, "24", "cannot have \"24\" texels"),
            (PACE, "0 20 20", "\"0 20 20\" does not say how often"),
            (PACE, "8 41 20", "cannot move as in \"8 41 20\""),
            (PACE, "8 20 21", "cannot move as in \"8 20 21\""),
            (PACE, "8 20", "\"8 20\" does not say how often"),
            (DECISIONS, "{}", "damaged: \"decisions\""),
            (
                DECISIONS,
                "[{\"step\":41,\"what\":\"lights\",\"on\":false,\"reason\":\"\",\"setting\":\"\"}]",
                "nothing was decided at step 41",
            ),
            (LAST, "inf", "\"inf\" is no error"),
            (LAST, "-1", "\"-1\" is no error"),
            (LAST, "", "\"\" is no error"),
            ("roll_backs", "[1]", "damaged: \"roll_backs\""),
        ] {
            let said = refused(&[(name, value)], &[]);
            assert!(said.contains(what), "{name} {value}: {said}");
        }
        let tensors: [(&str, &[f32], &str); 7] = [
            ("albedo", &[0.0; 4], "does not hold 3 32-bit floats"),
            ("albedo", &[0.0, f32::NAN, 0.0], "\"albedo\" holds values that are not finite"),
            ("albedo_moments", &[0.0; 3], "does not hold 6 32-bit floats"),
            ("albedo_moments", &[0.0, 0.0, 0.0, 0.0, f32::INFINITY, 0.0], "not finite"),
            ("albedo_moments", &[0.0, 0.0, 0.0, -1.0, 0.0, 0.0], "squares that are negative"),
            ("environment_after_41", &[0.0; 3], "is of no step until 40"),
            ("environment_after_", &[0.0; 3], "is of no step until 40"),
        ];
        for (name, values, what) in tensors {
            let said = refused(&[], &[(name, values)]);
            assert!(said.contains(what), "{name}: {said}");
        }
        let whole = bytes(&[], &[]);
        let cut = Saved::read(path, &whole[..whole.len() - 1]).err().unwrap().to_string();
        assert!(cut.contains("damaged") || cut.contains("not a checkpoint"), "{cut}");
        let saved = Saved::read(path, &whole).unwrap();
        assert!(saved.words("albedo", 3).err().unwrap().to_string().contains("3 32-bit words"));
        assert!(saved.floats("none", 3).err().unwrap().to_string().contains("has no \"none\""));
    }
}

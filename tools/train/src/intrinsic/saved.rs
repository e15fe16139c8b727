//! Checkpoint file of the intrinsic stage, parsed before a stage applies it.
//!
//! Guarantees: reading requires no device. A file that no stage could have written is rejected.

use super::automatic::Remembered;
use crate::course::{Course, json, wrong_moments};
use crate::decision::Decision;
use crate::error::error;
use crate::error::{Result, TrainError};
use safetensors::{Dtype, SafeTensors};
use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::path::Path;

/// Format name in the metadata.
pub(super) const FORMAT: &str = "sgs-intrinsic-1";

/// Tensor of the environment map's gradient, accumulated since its last update.
pub(super) const GATHERED: &str = "environment_gathered";

/// Tensors of the estimates under other lights, and of the steps of their requests.
pub(super) const ESTIMATES: &str = "relit_estimates";
pub(super) const REQUESTED_AT: &str = "relit_queried_at";

/// Metadata key of the decisions about the model.
pub(super) const DECISIONS: &str = "decisions";

/// Metadata key of the visibility field's levels, if selected automatically.
pub(super) const LEVELS: &str = "levels";

/// Metadata key of the environment map's edge length, if selected automatically.
/// The length is in texels.
pub(super) const TEXELS: &str = "texels";

/// Prefix of environment map snapshots; the step of the snapshot follows.
pub(super) const BEFORE: &str = "environment_after_";

/// Metadata key of the environment update interval, if selected automatically.
/// The value holds the interval in steps, the step of its last change, and the number of updates before.
pub(super) const UPDATE_INTERVAL: &str = "update_interval";

/// Metadata key of the error of shaded images at the last measurement.
pub(super) const LAST: &str = "last_error";

/// Tensor of the last values of losses that do not run in every step.
/// The order is pseudo-views, other lights, own priors, smoothness of the environment map.
pub(super) const RECENT: &str = "recent_losses";

/// Metadata key of the number of lobes of a light, if selected automatically.
pub(super) const LOBES: &str = "lobes";

/// Tensors of the visibility field.
pub(super) const FIELD: [&str; 4] =
    ["visibility_tables", "visibility_mlp", "visibility_tables_moments", "visibility_mlp_moments"];

/// Tensor of the gains of the lights.
pub(super) const GAINS: &str = "light_gains";

/// Contents of a checkpoint. Tensors are read once their sizes are known.
pub(crate) struct Saved<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
    /// Step after which the checkpoint was written.
    pub step: u32,
    /// Number of splats.
    pub splats: u32,
    /// Progress of the training.
    pub course: Course,
    /// Decisions about the model.
    pub decisions: Vec<Decision>,
    /// Lobes of a light, if selected automatically: from 1 to 32.
    pub lobes: Option<u32>,
    /// Levels of the visibility field, if selected automatically: at least 1.
    pub levels: Option<u32>,
    /// Texels per edge of the environment map, if selected automatically.
    /// A power of two, at least 16.
    pub texels: Option<u32>,
    /// Update interval of the environment map, if selected automatically.
    pub update_interval: Option<UpdateInterval>,
    /// Error of shaded images at the last measurement.
    pub last: Option<f64>,
}

/// Update interval of the environment map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct UpdateInterval {
    /// Interval in steps.
    pub every: u32,
    /// Step of the last change of the interval.
    pub since: u32,
    /// Number of updates until that step.
    pub moves: u32,
}

impl<'a> Saved<'a> {
    /// Reads a checkpoint's metadata and the index of its tensors.
    ///
    /// # Errors
    /// If the file is damaged, or is not a checkpoint of the intrinsic stage.
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
            update_interval: update_interval(&meta, step).map_err(refused)?,
            last: last(&meta).map_err(refused)?,
        })
    }

    /// Returns whether a tensor of this name exists.
    pub fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// Returns the values of a tensor.
    ///
    /// # Errors
    /// If their number is not `count`, or some are not finite.
    pub fn floats(&self, name: &str, count: usize) -> Result<Vec<f32>> {
        let data = self.data(name, count, Dtype::F32)?;
        let values: Vec<f32> = data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        match values.iter().all(|v| v.is_finite()) {
            true => Ok(values),
            false => Err(self.refused(format!("damaged: \"{name}\" holds values that are not finite"))),
        }
    }

    /// Returns pairs of first and second moments of `count` values.
    ///
    /// # Errors
    /// If their number is wrong, or some values are impossible.
    pub fn moments(&self, name: &str, count: usize) -> Result<Vec<f32>> {
        let values = self.floats(name, 2 * count)?;
        match wrong_moments(&values) {
            None => Ok(values),
            Some(wrong) => Err(self.refused(format!("damaged: \"{name}\" holds {wrong}"))),
        }
    }

    /// Returns the words of a tensor.
    ///
    /// # Errors
    /// If their number is not `count`.
    pub fn words(&self, name: &str, count: usize) -> Result<Vec<u32>> {
        let data = self.data(name, count, Dtype::U32)?;
        Ok(data.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect())
    }

    /// Returns the step of the latest request for each view under other lights.
    /// The step is 0 without a request.
    ///
    /// # Errors
    /// If their number is not `views`, or some are after the next step.
    pub fn requested_at(&self, views: usize) -> Result<Vec<u32>> {
        let steps = self.words(REQUESTED_AT, views)?;
        match steps.iter().find(|step| **step > self.step.saturating_add(1)) {
            None => Ok(steps),
            Some(later) => Err(self.refused(format!("damaged: \"{REQUESTED_AT}\" tells of step {later}"))),
        }
    }

    /// Returns the environment map snapshots, ordered by step, of `count` values each.
    ///
    /// # Errors
    /// If a snapshot has another size, or belongs to a step after the checkpoint's.
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

    /// Makes an error about the file.
    pub fn refused(&self, reason: String) -> TrainError {
        error(self.path, reason)
    }

    /// Makes the error of an impossible number of texels per edge.
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

/// Parses the update interval of the environment map, as of a step.
fn update_interval(meta: &HashMap<String, String>, step: u32) -> std::result::Result<Option<UpdateInterval>, String> {
    let Some(text) = meta.get(UPDATE_INTERVAL) else { return Ok(None) };
    let numbers: Option<Vec<u32>> = text.split(' ').map(|n| n.parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[every @ 1..=64, since, moves]) if since <= step && moves <= since => {
            Ok(Some(UpdateInterval { every, since, moves }))
        }
        Some(&[1..=64, _, _]) => Err(format!("damaged: \"{text}\" is no update interval of the environment map")),
        _ => Err(format!("damaged: \"{text}\" does not state the update interval of the environment map")),
    }
}

/// Parses the error at the last measurement.
fn last(meta: &HashMap<String, String>) -> std::result::Result<Option<f64>, String> {
    let Some(text) = meta.get(LAST) else { return Ok(None) };
    let value = text.parse().ok().filter(|last: &f64| *last >= 0.0 && last.is_finite());
    value.map(Some).ok_or_else(|| format!("damaged: \"{text}\" is no error of images"))
}

fn no_texels(path: &Path, size: &str) -> TrainError {
    error(path, format!("damaged: an environment map cannot have \"{size}\" texels along an edge"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_run::{floats::Floats, floats::Numbers, floats::serialize};

    /// Makes a checkpoint after 40 steps, with some metadata and tensors replaced.
    fn bytes(meta: &[(&str, &str)], tensors: &[(&str, &[f32])]) -> Vec<u8> {
        let fields = [
            ("format", FORMAT),
            ("step", "40"),
            ("splats", "1"),
            (LOBES, "6"),
            (LEVELS, "4"),
            (TEXELS, "16"),
            (UPDATE_INTERVAL, "8 20 20"),
            (LAST, "0.5"),
        ];
        let held: [(&str, &[f32]); 4] = [
            ("albedo", &[0.25, -1.0, 2.0]),
            ("albedo_moments", &[0.0, 1.0, -1.0, 0.0, 3.0, 2.0]),
            ("environment_after_36", &[2.0; 3]),
            ("environment_after_40", &[1.0; 3]),
        ];
        let meta: HashMap<_, _> = fields.iter().chain(meta).map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        let tensors: HashMap<_, _> = held.iter().chain(tensors).copied().collect();
        let floats = tensors.iter().map(|(name, v)| (*name, Numbers::Floats(Floats(v, vec![v.len()]))));
        let words = [(REQUESTED_AT, Numbers::Words(&[41, 0], vec![2]))];
        serialize(floats.chain(words), meta).unwrap()
    }

    #[test]
    fn valid_checkpoint_is_read() {
        let bytes = bytes(&[], &[]);
        let saved = Saved::read(Path::new("state"), &bytes).unwrap();
        assert_eq!((saved.step, saved.splats, saved.last, saved.decisions.len()), (40, 1, Some(0.5), 0));
        assert_eq!((saved.lobes, saved.levels, saved.texels), (Some(6), Some(4), Some(16)));
        assert_eq!(
            (saved.update_interval, saved.course.roll_backs.len()),
            (Some(UpdateInterval { every: 8, since: 20, moves: 20 }), 0)
        );
        assert_eq!(saved.floats("albedo", 3).unwrap(), [0.25, -1.0, 2.0]);
        assert_eq!(saved.moments("albedo_moments", 3).unwrap(), [0.0, 1.0, -1.0, 0.0, 3.0, 2.0]);
        assert_eq!(saved.requested_at(2).unwrap(), [41, 0]);
        assert_eq!(saved.before(3).unwrap(), [(36, vec![2.0; 3]), (40, vec![1.0; 3])]);
        assert!(saved.has("albedo") && !saved.has("roughness"));
    }

    #[test]
    fn impossible_checkpoints_are_rejected() {
        let path = Path::new("state");
        let refused = |meta: &[(&str, &str)], tensors: &[(&str, &[f32])]| -> String {
            let bytes = bytes(meta, tensors);
            let saved = match Saved::read(path, &bytes) {
                Ok(saved) => saved,
                Err(error) => return error.to_string(),
            };
            let values = [saved.floats("albedo", 3), saved.moments("albedo_moments", 3)];
            let errors = values.into_iter().filter_map(|v| v.err()).chain(saved.before(3).err());
            let errors = errors.chain(saved.requested_at(2).err());
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
            (UPDATE_INTERVAL, "0 20 20", "\"0 20 20\" does not state the update interval"),
            (UPDATE_INTERVAL, "8 41 20", "\"8 41 20\" is no update interval"),
            (UPDATE_INTERVAL, "8 20 21", "\"8 20 21\" is no update interval"),
            (UPDATE_INTERVAL, "8 20", "\"8 20\" does not state the update interval"),
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
            let error = refused(&[(name, value)], &[]);
            assert!(error.contains(what), "{name} {value}: {error}");
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
            let error = refused(&[], &[(name, values)]);
            assert!(error.contains(what), "{name}: {error}");
        }
        let whole = bytes(&[], &[]);
        let cut = Saved::read(path, &whole[..whole.len() - 1]).err().unwrap().to_string();
        assert!(cut.contains("damaged") || cut.contains("not a checkpoint"), "{cut}");
        let saved = Saved::read(path, &whole).unwrap();
        assert!(saved.words("albedo", 3).err().unwrap().to_string().contains("3 32-bit words"));
        assert!(saved.floats("none", 3).err().unwrap().to_string().contains("has no \"none\""));
    }
}

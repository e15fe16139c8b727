//! Variants of training: which parts of the method are on.

use super::Entry;
use crate::error::{Result, TrainError};
use crate::settings::Settings;
use sgs_scene::Scene;

/// What a variant may use besides photographs; each is a switch of the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Normals,
    Semantics,
    Correspondence,
}

/// A variant of training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// Its name, as in `--only`.
    pub name: &'static str,
    /// What it uses.
    pub about: &'static str,
    on: &'static [Part],
}

const ALL: [Variant; 4] = [
    Variant { name: "rgb", about: "photographs alone", on: &[] },
    Variant { name: "normal", about: "and priors of normals", on: &[Part::Normals] },
    Variant { name: "semantic", about: "and semantic priors", on: &[Part::Normals, Part::Semantics] },
    Variant {
        name: "correspondence",
        about: "and regions compared with pseudo-views",
        on: &[Part::Normals, Part::Semantics, Part::Correspondence],
    },
];

impl Variant {
    /// Every variant, in the order of the method: each uses what those before it use.
    pub fn all() -> &'static [Variant] {
        &ALL
    }

    /// Those of these names, in the order of the method; all if there are no names.
    ///
    /// # Errors
    /// If a name is not one of a variant; the sentence lists them.
    pub fn named(names: &[String]) -> Result<Vec<Variant>> {
        if let Some(name) = names.iter().find(|n| ALL.iter().all(|v| v.name != **n)) {
            let known = ALL.map(|v| v.name).join(", ");
            return Err(TrainError::Setting(format!("There is no variant \"{name}\"; there are {known}.")));
        }
        Ok(ALL.into_iter().filter(|v| names.is_empty() || names.iter().any(|n| n == v.name)).collect())
    }

    /// Settings with the parts of this variant switched on and all others off.
    pub fn settings(&self, base: &Settings) -> Settings {
        let mut settings = base.clone();
        let g = &mut settings.geometry;
        g.normals = self.on.contains(&Part::Normals);
        g.semantics = self.on.contains(&Part::Semantics);
        g.correspondence = self.on.contains(&Part::Correspondence);
        settings
    }

    /// Why it would be the same as another variant: what the scene or the settings lack, as an end of a sentence.
    ///
    /// # Errors
    /// If a prior cannot be read.
    pub fn lacks(&self, scene: &Scene, settings: &Settings) -> Result<Option<String>> {
        for part in self.on {
            let there = match part {
                Part::Normals => any(scene, |view| Ok(scene.normal_prior(view)?.is_some()))?,
                Part::Semantics => {
                    scene.text_embeddings()?.is_some() && any(scene, |view| Ok(scene.semantic_prior(view)?.is_some()))?
                }
                Part::Correspondence => true,
            };
            if !there {
                let folder = if *part == Part::Normals { "priors/normal" } else { "priors/semantic" };
                return Ok(Some(format!("the scene has no {folder}")));
            }
            let (steps, from) = (settings.geometry.steps, settings.geometry.correspondence_from);
            if *part == Part::Correspondence && from > steps {
                return Ok(Some(format!("it begins at step {from} of {steps} (geometry.correspondence_from)")));
            }
        }
        Ok(None)
    }

    /// As a row of a table.
    pub fn entry(&self) -> Entry {
        let order = ALL.iter().position(|v| v == self).unwrap_or(ALL.len());
        Entry { order, name: self.name, about: self.about.to_owned() }
    }
}

/// Whether something holds for a training view.
pub(super) fn any(scene: &Scene, holds: impl Fn(usize) -> Result<bool>) -> Result<bool> {
    for &view in &scene.split.train {
        if holds(view)? {
            return Ok(true);
        }
    }
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_differ_in_their_switches_alone() {
        let base = Settings { seed: 5, ..Settings::default() };
        let switches = |s: &Settings| [s.geometry.normals, s.geometry.semantics, s.geometry.correspondence];
        for (count, variant) in ALL.iter().enumerate() {
            let mut settings = variant.settings(&base);
            assert_eq!(switches(&settings), [0, 1, 2].map(|i| i < count), "{}", variant.name);
            let g = &mut settings.geometry;
            (g.normals, g.semantics, g.correspondence) = switches(&base).into();
            assert_eq!(settings, base);
        }
    }

    #[test]
    fn names_are_checked_and_keep_their_order() {
        let names = |n: &[&str]| n.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let found = Variant::named(&names(&["normal", "rgb"])).unwrap();
        assert_eq!(found.iter().map(|v| v.name).collect::<Vec<_>>(), ["rgb", "normal"]);
        assert_eq!(Variant::named(&[]).unwrap(), ALL);
        let error = Variant::named(&names(&["rgb", "magic"])).unwrap_err().to_string();
        assert!(
            error.starts_with("There is no variant \"magic\"; there are rgb, normal, semantic, correspondence."),
            "{error}"
        );
        assert_eq!(found[1].entry().folder(3), "normal_seed3");
    }
}

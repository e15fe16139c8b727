//! Variants of training: which parts of the method are on.

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

impl Part {
    const ALL: [Part; 3] = [Part::Normals, Part::Semantics, Part::Correspondence];

    /// The switch, in `[geometry]`.
    fn switch(self) -> &'static str {
        match self {
            Part::Normals => "normals",
            Part::Semantics => "semantics",
            Part::Correspondence => "correspondence",
        }
    }
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
    Variant { name: "correspondence", about: "and regions compared with pseudo-views", on: &Part::ALL },
];

/// Where a variant of this name stands in the method.
pub(super) fn place(name: &str) -> usize {
    ALL.iter().position(|v| v.name == name).unwrap_or(ALL.len())
}

impl Variant {
    /// Every variant that there are settings for, in the order of the method.
    ///
    /// # Errors
    /// If settings cannot be written as a table.
    pub fn all() -> Result<Vec<Variant>> {
        let settings = Settings::default();
        let known = |v: &Variant| Ok(v.settings(&settings)?.is_some().then_some(*v));
        ALL.iter().filter_map(|v| known(v).transpose()).collect()
    }

    /// Those of these names, in the order of the method; all if there are no names.
    ///
    /// # Errors
    /// If a name is not one of a variant; the sentence lists them.
    pub fn named(names: &[String]) -> Result<Vec<Variant>> {
        let all = Variant::all()?;
        if let Some(name) = names.iter().find(|n| all.iter().all(|v| v.name != **n)) {
            let known = all.iter().map(|v| v.name).collect::<Vec<_>>().join(", ");
            return Err(TrainError::Setting(format!("There is no variant \"{name}\"; there are {known}.")));
        }
        Ok(all.into_iter().filter(|v| names.is_empty() || names.iter().any(|n| n == v.name)).collect())
    }

    /// Settings with the parts of this variant switched on and all others off; none if a switch does not exist.
    ///
    /// # Errors
    /// If settings cannot be written as a table.
    pub fn settings(&self, base: &Settings) -> Result<Option<Settings>> {
        let mut table = base.to_table()?;
        let Some(toml::Value::Table(geometry)) = table.get_mut("geometry") else { return Ok(None) };
        for part in Part::ALL {
            match geometry.get_mut(part.switch()) {
                Some(switch) => *switch = toml::Value::Boolean(self.on.contains(&part)),
                None if self.on.contains(&part) => return Ok(None),
                None => {}
            }
        }
        Settings::from_table(table).map(Some)
    }

    /// The first part of it that the scene has no priors for, by name. Without them it is another variant.
    ///
    /// # Errors
    /// If a prior cannot be read.
    pub fn lacks(&self, scene: &Scene) -> Result<Option<&'static str>> {
        for part in self.on {
            let mut there = false;
            for &view in &scene.split.train {
                there = there
                    || match part {
                        Part::Normals => scene.normal_prior(view)?.is_some(),
                        _ => scene.text_embeddings()?.is_some() && scene.semantic_prior(view)?.is_some(),
                    };
            }
            if !there {
                return Ok(Some(if *part == Part::Normals { "priors/normal" } else { "priors/semantic" }));
            }
        }
        Ok(None)
    }

    /// Its folder for a seed.
    pub fn folder(&self, seed: u64) -> String {
        format!("{}_seed{seed}", self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_differ_in_their_switches_alone() {
        let base = Settings { seed: 5, ..Settings::default() };
        let of = |name: &str| Variant::named(&[name.to_owned()]).unwrap()[0].settings(&base).unwrap().unwrap();
        let (rgb, normal) = (of("rgb"), of("normal"));
        assert!(!rgb.geometry.normals && normal.geometry.normals);
        let mut same = rgb.clone();
        same.geometry.normals = true;
        assert_eq!(same, normal);
        assert_eq!((rgb.seed, rgb.geometry.losses), (5, base.geometry.losses));
    }

    #[test]
    fn names_are_checked_and_keep_their_order() {
        let names = |n: &[&str]| n.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let found = Variant::named(&names(&["normal", "rgb"])).unwrap();
        assert_eq!(found.iter().map(|v| v.name).collect::<Vec<_>>(), ["rgb", "normal"]);
        assert_eq!(Variant::named(&[]).unwrap(), Variant::all().unwrap());
        let error = Variant::named(&names(&["rgb", "magic"])).unwrap_err().to_string();
        assert!(error.starts_with("There is no variant \"magic\"; there are rgb, normal"), "{error}");
        assert_eq!(found[1].folder(3), "normal_seed3");
    }
}

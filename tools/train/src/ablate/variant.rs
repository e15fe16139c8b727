//! Variants of training: which parts of the method are on.

use super::Entry;
use super::change::Change;
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

/// What a variant is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Geometry that uses these parts alone.
    Geometry(&'static [Part]),
    /// Materials on the same geometry, with a change.
    Materials(Change),
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Geometry alone.
    Geometry,
    /// Materials, lights and shadows on geometry that all variants have in common.
    Materials,
    /// Both: variants of geometry with materials on them, and variants of materials on the last of these.
    Whole,
}

/// A variant of training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// Its name, as in `--only`.
    pub name: &'static str,
    /// What it uses, or does without.
    pub about: &'static str,
    kind: Kind,
}

const fn geometry(name: &'static str, about: &'static str, on: &'static [Part]) -> Variant {
    Variant { name, about, kind: Kind::Geometry(on) }
}

const fn materials(name: &'static str, about: &'static str, change: Change) -> Variant {
    Variant { name, about, kind: Kind::Materials(change) }
}

const ALL: [Variant; 12] = [
    geometry("rgb", "photographs alone", &[]),
    geometry("normal", "and priors of normals", &[Part::Normals]),
    geometry("semantic", "and semantic priors", &[Part::Normals, Part::Semantics]),
    geometry(
        "correspondence",
        "and regions compared with pseudo-views",
        &[Part::Normals, Part::Semantics, Part::Correspondence],
    ),
    materials("full", "everything", Change::Nothing),
    materials("gray_start", "materials begin gray", Change::GrayStart),
    materials("no_lights", "without point lights", Change::Lights),
    materials("no_environment", "without light of the surroundings", Change::Environment),
    materials("no_visibility", "without shadows", Change::Visibility),
    materials("no_cross_view", "albedo not compared between views", Change::CrossView),
    materials("no_relight", "albedo not compared under other lights", Change::Relight),
    materials("no_priors", "without what networks say of materials", Change::Priors),
];

impl Scope {
    /// Its variants, in their order.
    pub fn variants(self) -> Vec<Variant> {
        let shown = |v: &&Variant| match (self, v.kind) {
            (Scope::Geometry, Kind::Geometry(_)) | (Scope::Materials, Kind::Materials(_)) => true,
            // Everything is what the last variant of geometry has.
            (Scope::Whole, kind) => kind != Kind::Materials(Change::Nothing),
            _ => false,
        };
        ALL.iter().filter(shown).copied().collect()
    }
}

impl Variant {
    /// Those of these names, in the order of the method; all of the scope if there are no names.
    ///
    /// # Errors
    /// If a name is not one of a variant; the sentence lists them.
    pub fn named(scope: Scope, names: &[String]) -> Result<Vec<Variant>> {
        let all = scope.variants();
        if let Some(name) = names.iter().find(|n| all.iter().all(|v| v.name != **n)) {
            let known = all.iter().map(|v| v.name).collect::<Vec<_>>().join(", ");
            return Err(TrainError::Setting(format!("There is no variant \"{name}\"; there are {known}.")));
        }
        Ok(all.into_iter().filter(|v| names.is_empty() || names.iter().any(|n| n == v.name)).collect())
    }

    /// Whether it is one of materials, on geometry that others have, too.
    pub fn is_of_materials(&self) -> bool {
        matches!(self.kind, Kind::Materials(_))
    }

    /// Settings as it wants them: of one of geometry, its parts switched on and all others off; of one of materials, one thing
    /// changed.
    pub fn settings(&self, base: &Settings) -> Settings {
        let mut settings = base.clone();
        match self.kind {
            Kind::Geometry(on) => {
                let g = &mut settings.geometry;
                g.normals = on.contains(&Part::Normals);
                g.semantics = on.contains(&Part::Semantics);
                g.correspondence = on.contains(&Part::Correspondence);
            }
            Kind::Materials(change) => change.apply(&mut settings.intrinsic),
        }
        settings
    }

    /// Why it would be the same as another variant: what the scene or the settings lack, as an end of a sentence.
    ///
    /// # Errors
    /// If a prior cannot be read.
    pub fn lacks(&self, scene: &Scene, settings: &Settings) -> Result<Option<String>> {
        let on = match self.kind {
            Kind::Geometry(on) => on,
            Kind::Materials(change) => return change.lacks(scene, settings),
        };
        for part in on {
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
    use crate::settings::{MaterialStart, VisibilityKind};

    #[test]
    fn variants_of_geometry_differ_in_their_switches_alone() {
        let base = Settings { seed: 5, ..Settings::default() };
        let switches = |s: &Settings| [s.geometry.normals, s.geometry.semantics, s.geometry.correspondence];
        for (count, variant) in Scope::Geometry.variants().iter().enumerate() {
            let mut settings = variant.settings(&base);
            assert_eq!(switches(&settings), [0, 1, 2].map(|i| i < count), "{}", variant.name);
            let g = &mut settings.geometry;
            (g.normals, g.semantics, g.correspondence) = switches(&base).into();
            assert_eq!(settings, base);
        }
    }

    #[test]
    fn variants_of_materials_differ_in_one_thing() {
        let base = Settings { seed: 5, ..Settings::default() };
        let of = |name: &str| {
            let variant = ALL.iter().find(|v| v.name == name).unwrap();
            let mut settings = variant.settings(&base);
            assert_eq!(settings == base, name == "full", "{name}");
            let changed = std::mem::replace(&mut settings.intrinsic, base.intrinsic.clone());
            assert_eq!(settings, base, "{name}");
            changed
        };
        assert_eq!(of("full"), base.intrinsic);
        assert_eq!(of("gray_start").start, MaterialStart::Gray);
        assert!(!of("no_lights").lights.enabled && !of("no_environment").environment.enabled);
        assert_eq!(of("no_visibility").visibility.kind, VisibilityKind::None);
        assert_eq!((of("no_cross_view").losses.cross_view, of("no_relight").losses.relight), (0.0, 0.0));
        let l = of("no_priors").losses;
        assert_eq!([l.albedo, l.roughness, l.metallic], [0.0; 3]);
        // What cannot be together is not asked for.
        let mut base = base.clone();
        base.intrinsic.relight.provider = "ask me".into();
        for variant in Scope::Materials.variants() {
            variant.settings(&base).check().unwrap();
        }
    }

    #[test]
    fn names_are_checked_and_keep_their_order() {
        let names = |n: &[&str]| n.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let found = Variant::named(Scope::Geometry, &names(&["normal", "rgb"])).unwrap();
        assert_eq!(found.iter().map(|v| v.name).collect::<Vec<_>>(), ["rgb", "normal"]);
        assert_eq!(Variant::named(Scope::Geometry, &[]).unwrap(), ALL[..4]);
        assert_eq!(Variant::named(Scope::Materials, &[]).unwrap(), ALL[4..]);
        let whole = Variant::named(Scope::Whole, &[]).unwrap();
        assert!(whole.len() == 11 && whole.iter().all(|v| v.name != "full"));
        let error = Variant::named(Scope::Geometry, &names(&["magic"])).unwrap_err().to_string();
        assert!(
            error.starts_with("There is no variant \"magic\"; there are rgb, normal, semantic, correspondence."),
            "{error}"
        );
        assert_eq!(found[1].entry().folder(3), "normal_seed3");
    }
}

//! Variants of training: enabled components of the method.

use super::Entry;
use super::change::Change;
use crate::error::{Result, StudyError};
use sgs_config::{Settings, TransportPart};
use sgs_run::StageKind;
use sgs_scene::Scene;

/// Component that a variant may use besides photographs. Each is a switch of the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Depth,
    Normals,
    Semantics,
    Correspondence,
}

/// Components of the full method of the geometry stage.
const FULL: [Part; 4] = [Part::Depth, Part::Normals, Part::Semantics, Part::Correspondence];

/// Kind of a variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Geometry with these components alone. Each such variant extends the one before.
    Geometry(&'static [Part]),
    /// Geometry by the full method without these components.
    Without(&'static [Part]),
    /// Materials on the same geometry, with a change.
    Materials(Change),
    /// Emitters and bounced light on the same geometry, without a part.
    Transport(Option<TransportPart>),
    /// Materials under the lights of the published model, on the same geometry.
    Published,
}

/// Scope of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Geometry alone.
    Geometry,
    /// Materials, lights and shadows on common geometry.
    Materials,
    /// Emitters and bounced light on common geometry.
    Transport,
    /// Both: variants of geometry with materials, and variants of materials on the last of these.
    Whole,
}

/// Variant of training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// Name, as in `--only`.
    pub name: &'static str,
    /// Components that the variant uses or leaves out.
    pub about: &'static str,
    /// Variant that shares its runs with this one, because the settings are equal. Otherwise this variant's own name.
    run: &'static str,
    kind: Kind,
}

const fn geometry(name: &'static str, about: &'static str, on: &'static [Part]) -> Variant {
    Variant { name, about, run: name, kind: Kind::Geometry(on) }
}

const fn without(name: &'static str, about: &'static str, run: &'static str, off: &'static [Part]) -> Variant {
    Variant { name, about, run, kind: Kind::Without(off) }
}

const fn materials(name: &'static str, about: &'static str, change: Change) -> Variant {
    Variant { name, about, run: name, kind: Kind::Materials(change) }
}

const fn transport(name: &'static str, about: &'static str, without: Option<TransportPart>) -> Variant {
    Variant { name, about, run: name, kind: Kind::Transport(without) }
}

const ALL: [Variant; 24] = [
    geometry("rgb", "photographs alone", &[]),
    geometry("depth", "and depth smoothness and variance", &[Part::Depth]),
    geometry("normal", "and priors of normals", &[Part::Depth, Part::Normals]),
    geometry("semantic", "and semantic priors", &[Part::Depth, Part::Normals, Part::Semantics]),
    geometry("correspondence", "and regions compared with pseudo-views", &FULL),
    without("no_normal", "full method without priors of normals", "no_normal", &[Part::Normals]),
    without("no_depth", "full method without depth smoothness and variance", "no_depth", &[Part::Depth]),
    without("no_semantic", "full method without semantics", "normal", &[Part::Semantics, Part::Correspondence]),
    without("no_correspondence", "full method without pseudo-views", "semantic", &[Part::Correspondence]),
    materials("full", "everything", Change::Nothing),
    materials("gray_start", "materials begin gray", Change::GrayStart),
    materials("no_lights", "without point lights", Change::Lights),
    materials("no_environment", "without an environment map", Change::Environment),
    materials("no_visibility", "without shadows", Change::Visibility),
    materials("no_cross_view", "albedo not compared between views", Change::CrossView),
    materials("no_relight", "albedo not compared with estimates under other lights", Change::Relight),
    materials("no_own_prior", "albedo of regions not compared with the views' own priors", Change::OwnPrior),
    materials("no_priors", "without what networks say of materials", Change::Priors),
    transport("bounced", "emitters, bounced light and materials", None),
    transport("no_bounces", "without bounced light", Some(TransportPart::Bounces)),
    transport("no_closure", "without light from surfaces that no view sees", Some(TransportPart::Enclosure)),
    transport("no_emission", "surfaces of emitters are dark to the camera", Some(TransportPart::Emission)),
    transport("no_specular", "all surfaces are matte: roughness 1, metallic 0", Some(TransportPart::Specular)),
    Variant {
        name: "published",
        about: "free lights, environment and shadows of the intrinsic stage",
        run: "published",
        kind: Kind::Published,
    },
];

impl Scope {
    /// Returns the variants of the scope, in order.
    pub fn variants(self) -> Vec<Variant> {
        let shown = |v: &&Variant| match (self, v.kind) {
            (Scope::Geometry, Kind::Geometry(_) | Kind::Without(_)) | (Scope::Materials, Kind::Materials(_)) => true,
            (Scope::Transport, Kind::Transport(_) | Kind::Published) => true,
            (Scope::Whole, Kind::Transport(_) | Kind::Published) => false,
            // The last variant of geometry is the full method, so the variant without a change is redundant.
            (Scope::Whole, kind) => kind != Kind::Materials(Change::Nothing),
            _ => false,
        };
        ALL.iter().filter(shown).copied().collect()
    }
}

impl Variant {
    /// Returns the variants of these names, in the order of the method. Returns all of the scope without names.
    ///
    /// # Errors
    /// If a variant of a name does not exist. The error lists the names.
    pub fn named(scope: Scope, names: &[String]) -> Result<Vec<Variant>> {
        let all = scope.variants();
        if let Some(name) = names.iter().find(|n| all.iter().all(|v| v.name != **n)) {
            let known = all.iter().map(|v| v.name).collect::<Vec<_>>().join(", ");
            return Err(StudyError::UnknownRow { kind: "variant", name: name.clone(), known });
        }
        Ok(all.into_iter().filter(|v| names.is_empty() || names.iter().any(|n| n == v.name)).collect())
    }

    /// Returns the stage that the variant trains on common geometry, if it does.
    pub fn stage(&self) -> Option<StageKind> {
        match self.kind {
            Kind::Geometry(_) | Kind::Without(_) => None,
            Kind::Materials(_) | Kind::Published => Some(StageKind::Intrinsic),
            Kind::Transport(_) => Some(StageKind::Transport),
        }
    }

    /// Returns whether the variant is the full geometry method without a component.
    pub fn leaves_out(&self) -> bool {
        matches!(self.kind, Kind::Without(_))
    }

    /// Returns whether a variant of geometry uses a component.
    fn uses(&self, part: Part) -> bool {
        match self.kind {
            Kind::Geometry(on) => on.contains(&part),
            Kind::Without(off) => !off.contains(&part),
            _ => false,
        }
    }

    /// Returns the settings of the variant. A variant of geometry disables the components that it does not use. A variant
    /// of materials or of transport changes one component.
    pub fn settings(&self, base: &Settings) -> Settings {
        let mut settings = base.clone();
        match self.kind {
            Kind::Materials(change) => change.apply(&mut settings.intrinsic),
            Kind::Transport(without) => settings.transport.without = without,
            Kind::Published | Kind::Geometry(_) | Kind::Without(_) => {}
        }
        if self.stage().is_some() {
            return settings;
        }
        let g = &mut settings.geometry;
        g.normals = self.uses(Part::Normals);
        g.semantics = self.uses(Part::Semantics);
        if !self.uses(Part::Depth) {
            (g.losses.depth_smooth, g.losses.depth_variance) = (0.0, 0.0);
        }
        if !self.uses(Part::Correspondence) {
            g.losses.correspondence = 0.0;
        }
        settings
    }

    /// Returns why the variant would equal another one, as the end of a sentence. The scene or the settings may lack an
    /// input. None if the variant differs.
    ///
    /// # Errors
    /// If a prior cannot be read.
    pub fn lacks(&self, scene: &Scene, settings: &Settings) -> Result<Option<String>> {
        let on = match self.kind {
            Kind::Geometry(on) => on,
            // Leaving out a component matters only if the scene has the inputs of the full method.
            Kind::Without(_) => &FULL,
            Kind::Materials(change) => return change.lacks(scene, settings),
            Kind::Transport(_) if !settings.transport.enabled() => {
                return Ok(Some("the settings leave the transport stage out (transport.surfels)".to_owned()));
            }
            Kind::Transport(_) | Kind::Published => return Ok(None),
        };
        let losses = &settings.geometry.losses;
        if matches!(self.kind, Kind::Geometry([Part::Depth]) | Kind::Without([Part::Depth]))
            && losses.depth_smooth + losses.depth_variance == 0.0
        {
            return Ok(Some("the losses of depth weigh nothing".to_owned()));
        }
        for part in on {
            let there = match part {
                Part::Normals => any(scene, |view| Ok(scene.normal_prior(view)?.is_some()))?,
                Part::Semantics => {
                    scene.text_embeddings()?.is_some() && any(scene, |view| Ok(scene.semantic_prior(view)?.is_some()))?
                }
                Part::Depth | Part::Correspondence => true,
            };
            if !there {
                let folder = if *part == Part::Normals { "priors/normal" } else { "priors/semantic" };
                return Ok(Some(format!("the scene has no {folder}")));
            }
            if *part == Part::Correspondence && losses.correspondence == 0.0 {
                return Ok(Some("the loss of regions weighs nothing".to_owned()));
            }
            let (steps, from) = (settings.geometry.steps, settings.geometry.correspondence_from);
            if *part == Part::Correspondence && from > steps {
                return Ok(Some(format!("it begins at step {from} of {steps} (geometry.correspondence_from)")));
            }
        }
        Ok(None)
    }

    /// Returns the row of a table.
    pub fn entry(&self) -> Entry {
        let order = ALL.iter().position(|v| v == self).unwrap_or(ALL.len());
        Entry { order, name: self.name, about: self.about.to_owned(), run: self.run }
    }
}

/// Returns whether a predicate holds for any training view.
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
    use sgs_config::{MaterialStart, VisibilityKind};

    #[test]
    fn geometry_variants_differ_only_in_components() {
        let base = Settings { seed: 5, ..Settings::default() };
        let of = |variant: &Variant| {
            let mut settings = variant.settings(&base);
            let g = &mut settings.geometry;
            let (l, full) = (&mut g.losses, &base.geometry.losses);
            assert_eq!(l.depth_smooth > 0.0, l.depth_variance > 0.0);
            let components = [l.depth_smooth > 0.0, g.normals, g.semantics, l.correspondence > 0.0];
            (l.depth_smooth, l.depth_variance) = (full.depth_smooth, full.depth_variance);
            l.correspondence = full.correspondence;
            (g.normals, g.semantics) = (true, true);
            assert_eq!(settings, base, "{}", variant.name);
            components
        };
        for (count, variant) in Scope::Geometry.variants().iter().take(5).enumerate() {
            assert_eq!(of(variant), [0, 1, 2, 3].map(|i| i < count), "{}", variant.name);
        }
        let named = |name: &str| ALL.iter().find(|v| v.name == name).unwrap();
        assert_eq!(of(named("no_normal")), [true, false, true, true]);
        assert_eq!(of(named("no_depth")), [false, true, true, true]);
        assert_eq!(of(named("no_semantic")), [true, true, false, false]);
        assert_eq!(of(named("no_correspondence")), [true, true, true, false]);
    }

    #[test]
    fn variants_of_equal_settings_share_runs() {
        let base = Settings::default();
        let variants = Scope::Geometry.variants();
        for a in &variants {
            for b in &variants {
                let same_run = a.entry().folder(0) == b.entry().folder(0);
                assert_eq!(a.settings(&base) == b.settings(&base), same_run, "{} and {}", a.name, b.name);
            }
        }
    }

    #[test]
    fn material_variants_differ_in_one_component() {
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
        assert!(!of("no_lights").lights.enabled() && !of("no_environment").environment.enabled());
        assert_eq!(of("no_visibility").visibility.kind, VisibilityKind::None);
        assert_eq!((of("no_cross_view").losses.cross_view, of("no_relight").losses.relight), (0.0, 0.0));
        let l = of("no_priors").losses;
        assert_eq!([l.albedo, l.roughness, l.metallic], [0.0; 3]);
        // Incompatible settings are not combined.
        let mut base = base.clone();
        base.intrinsic.relight.provider = "ask me".into();
        for variant in Scope::Materials.variants() {
            variant.settings(&base).check().unwrap();
        }
    }

    #[test]
    fn transport_variants_leave_out_one_part() {
        let base = Settings { seed: 5, ..Settings::default() };
        for variant in Scope::Transport.variants() {
            let settings = variant.settings(&base);
            let without = settings.transport.without;
            let transport = sgs_config::TransportSettings { without: None, ..settings.transport };
            assert_eq!(Settings { transport, ..settings }, base, "{}", variant.name);
            assert_eq!(without.is_some(), variant.name.starts_with("no_"), "{}", variant.name);
            let stage = if variant.name == "published" { StageKind::Intrinsic } else { StageKind::Transport };
            assert_eq!(variant.stage(), Some(stage));
        }
    }

    #[test]
    fn names_are_checked_and_ordered() {
        let names = |n: &[&str]| n.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let found = Variant::named(Scope::Geometry, &names(&["normal", "rgb"])).unwrap();
        assert_eq!(found.iter().map(|v| v.name).collect::<Vec<_>>(), ["rgb", "normal"]);
        assert_eq!(Variant::named(Scope::Geometry, &[]).unwrap(), ALL[..9]);
        assert_eq!(Variant::named(Scope::Materials, &[]).unwrap(), ALL[9..18]);
        assert_eq!(Variant::named(Scope::Transport, &[]).unwrap(), ALL[18..]);
        let whole = Variant::named(Scope::Whole, &[]).unwrap();
        assert!(whole.len() == 17 && whole.iter().all(|v| v.name != "full"));
        let error = Variant::named(Scope::Geometry, &names(&["magic"])).unwrap_err().to_string();
        assert!(
            error.starts_with(
                "There is no variant \"magic\"; there are rgb, depth, normal, semantic, correspondence, no_normal"
            ),
            "{error}"
        );
        assert_eq!(found[1].entry().folder(3), "normal_seed3");
    }
}

//! Losses that have a weight and cannot run, with the missing input and the remedy.
//!
//! A switch that removes a component of the model (`geometry.normals = false`, no lights) also removes its losses,
//! without a warning.

use serde::Serialize;
use sgs_config::{Metallic, Settings};

/// Loss whose weight is not zero and that cannot run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IdleLoss {
    /// Stage: `geometry` or `intrinsic`.
    pub stage: &'static str,
    /// Name of the loss.
    pub loss: &'static str,
    /// Setting that holds the weight of the loss.
    pub setting: &'static str,
    /// Missing input.
    pub missing: String,
    /// How to provide the input.
    pub remedy: String,
}

impl IdleLoss {
    /// Returns the warnings: one sentence for all losses of a stage that lack the same input.
    pub fn warnings(all: &[IdleLoss]) -> Vec<String> {
        let mut groups: Vec<Vec<&IdleLoss>> = Vec::new();
        for idle in all {
            let same = |other: &IdleLoss| {
                (other.stage, &other.missing, &other.remedy) == (idle.stage, &idle.missing, &idle.remedy)
            };
            match groups.iter_mut().find(|group| same(group[0])) {
                Some(group) => group.push(idle),
                None => groups.push(vec![idle]),
            }
        }
        let sentence = |group: Vec<&IdleLoss>| {
            let names = listed(&group.iter().map(|idle| idle.loss).collect::<Vec<_>>());
            let settings = listed(&group.iter().map(|idle| idle.setting).collect::<Vec<_>>());
            let (missing, remedy) = (&group[0].missing, &group[0].remedy);
            match group.len() {
                1 => format!("{names} does not run: {missing}; {remedy}, or set {settings} = 0"),
                _ => format!("{names} do not run: {missing}; {remedy}, or set {settings} to 0"),
            }
        };
        groups.into_iter().map(sentence).collect()
    }
}

/// Joins words to a list in a sentence.
fn listed(words: &[&str]) -> String {
    match words {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// Inputs that the geometry stage found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FoundForGeometry {
    pub normals: bool,
    pub depths: bool,
    pub semantics: bool,
    pub regions: bool,
}

/// Materials of which the scene has priors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PriorKinds {
    /// Whether the scene has albedo priors.
    pub albedo: bool,
    /// Whether the scene has roughness priors.
    pub roughness: bool,
    /// Whether the scene has metallic priors.
    pub metallic: bool,
}

/// Inputs that the intrinsic stage found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FoundForMaterials {
    pub priors: PriorKinds,
    pub regions: bool,
    /// Whether a provider of materials answers.
    pub estimates: bool,
}

fn prior(kind: &str) -> (String, String) {
    (format!("the scene has no {kind} priors"), format!("add priors/{kind} (sgs priors)"))
}

fn late(from: u32, steps: u32, setting: &str) -> (String, String) {
    (format!("it begins at step {from}, and training ends at step {steps}"), format!("lower {setting}"))
}

fn regions(s: &Settings) -> (String, String) {
    if s.provider.command.trim().is_empty() {
        return ("no regions".into(), "add priors/masks, semantic priors or provider.command".into());
    }
    ("the provider of masks does not answer".into(), "mend provider.command".into())
}

/// Returns the losses of the geometry stage that cannot run.
pub(crate) fn of_geometry(s: &Settings, found: FoundForGeometry) -> Vec<IdleLoss> {
    let g = &s.geometry;
    let mut idle = Vec::new();
    let mut add = |loss, setting, (missing, remedy)| {
        idle.push(IdleLoss { stage: "geometry", loss, setting, missing, remedy });
    };
    if g.normals && !found.normals {
        if g.losses.normal > 0.0 {
            add("L_normal", "geometry.losses.normal", prior("normal"));
        }
        if g.losses.normal_smooth > 0.0 {
            add("normal smoothness", "geometry.losses.normal_smooth", prior("normal"));
        }
    }
    if g.semantics && !found.semantics {
        if g.losses.semantic > 0.0 {
            add("L_semantic (features)", "geometry.losses.semantic", prior("semantic"));
        }
        if g.losses.semantic_class > 0.0 {
            add("L_semantic (classes)", "geometry.losses.semantic_class", prior("semantic"));
        }
    }
    if g.losses.correspondence > 0.0 && !found.regions {
        let why = if !g.semantics {
            ("geometry.semantics is false".into(), "set geometry.semantics = true".into())
        } else if !found.semantics {
            prior("semantic")
        } else if g.correspondence_from > g.steps {
            late(g.correspondence_from, g.steps, "geometry.correspondence_from")
        } else {
            regions(s)
        };
        add("L_corresponding", "geometry.losses.correspondence", why);
    }
    idle
}

/// Returns the losses of the intrinsic stage that cannot run.
/// `s`: settings after automatic model selection.
pub(crate) fn of_materials(s: &Settings, found: FoundForMaterials) -> Vec<IdleLoss> {
    let i = &s.intrinsic;
    let l = &i.losses;
    let PriorKinds { albedo, roughness, metallic } = found.priors;
    let mut idle = Vec::new();
    let mut add = |loss, setting, (missing, remedy)| {
        idle.push(IdleLoss { stage: "intrinsic", loss, setting, missing, remedy });
    };
    if l.albedo > 0.0 && !albedo {
        add("albedo prior", "intrinsic.losses.albedo", prior("albedo"));
    }
    if l.roughness > 0.0 && !roughness {
        add("roughness prior", "intrinsic.losses.roughness", prior("roughness"));
    }
    if l.metallic > 0.0 && !metallic && i.metallic != Metallic::Off {
        add("metallic prior", "intrinsic.losses.metallic", prior("metallic"));
    }
    if l.cross_view > 0.0 && !found.regions {
        add("L_cross_semantic", "intrinsic.losses.cross_view", regions(s));
    }
    if l.relight > 0.0 {
        let why = if i.relight.command().is_none() {
            Some(("no provider of materials".into(), "set intrinsic.relight.provider".into()))
        } else if i.relight_from > i.steps {
            Some(late(i.relight_from, i.steps, "intrinsic.relight_from"))
        } else if !found.regions {
            Some(regions(s))
        } else if !found.estimates {
            Some(("the provider of materials does not answer".into(), "mend intrinsic.relight.provider".into()))
        } else {
            None
        };
        if let Some(why) = why {
            add("L_relight", "intrinsic.losses.relight", why);
        }
    }
    if i.own_prior_weight() > 0.0 {
        let why = if i.relight_from > i.steps {
            Some(late(i.relight_from, i.steps, "intrinsic.relight_from"))
        } else if !albedo && l.albedo > 0.0 {
            Some(prior("albedo"))
        } else if !albedo {
            Some(("intrinsic.losses.albedo is 0, so that no prior is read".into(), "give it a weight".into()))
        } else if !found.regions {
            Some(regions(s))
        } else {
            None
        };
        if let Some(why) = why {
            add("comparison with the own prior", "intrinsic.losses.own_prior", why);
        }
    }
    idle
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_config::{OwnPrior, Preset};

    fn names(idle: &[IdleLoss]) -> Vec<&str> {
        idle.iter().map(|i| i.setting.rsplit('.').next().unwrap_or_default()).collect()
    }

    #[test]
    fn idle_geometry_losses_name_missing_inputs() {
        let mut s = Settings::default();
        let none = FoundForGeometry { normals: false, depths: false, semantics: false, regions: false };
        let idle = of_geometry(&s, none);
        assert_eq!(names(&idle), ["normal", "normal_smooth", "semantic", "semantic_class", "correspondence"]);
        assert_eq!(
            IdleLoss::warnings(&idle),
            [
                "L_normal and normal smoothness do not run: the scene has no normal priors; add priors/normal (sgs priors), or set \
                 geometry.losses.normal and geometry.losses.normal_smooth to 0",
                "L_semantic (features), L_semantic (classes) and L_corresponding do not run: the scene has no semantic priors; add \
                 priors/semantic (sgs priors), or set geometry.losses.semantic, geometry.losses.semantic_class and \
                 geometry.losses.correspondence to 0",
            ]
        );
        let all = FoundForGeometry { normals: true, depths: true, semantics: true, regions: true };
        assert_eq!(of_geometry(&s, all), []);
        let text =
            |s: &Settings| IdleLoss::warnings(&of_geometry(s, FoundForGeometry { regions: false, ..all })).remove(0);
        assert!(text(&s).contains("no regions; add priors/masks, semantic priors or provider.command"), "{}", text(&s));
        s.provider.command = "ask".into();
        assert!(text(&s).contains("the provider of masks does not answer"), "{}", text(&s));
        s.geometry.steps = 100;
        assert!(text(&s).contains("begins at step 2000, and training ends at step 100"), "{}", text(&s));
        // Losses that are switched off or have weight zero cause no warning.
        (s.geometry.normals, s.geometry.semantics, s.geometry.losses.correspondence) = (false, false, 0.0);
        assert_eq!(of_geometry(&s, none), []);
        let mut s = Settings::default();
        let l = &mut s.geometry.losses;
        (l.normal, l.normal_smooth, l.semantic, l.semantic_class, l.correspondence) = (0.0, 0.0, 0.0, 0.0, 0.0);
        assert_eq!(of_geometry(&s, none), []);
    }

    #[test]
    fn idle_intrinsic_losses_name_missing_inputs() {
        let mut s = Settings::default();
        let priors = |known| PriorKinds { albedo: known, roughness: known, metallic: known };
        let none = FoundForMaterials { priors: priors(false), regions: false, estimates: false };
        let all = FoundForMaterials { priors: priors(true), regions: true, estimates: true };
        let idle = of_materials(&s, none);
        let expected = ["albedo", "roughness", "metallic", "cross_view", "relight", "own_prior"];
        assert_eq!(names(&idle), expected);
        // The default has no provider: the published loss does not run, the comparison with priors does.
        assert_eq!(names(&of_materials(&s, all)), ["relight"]);
        s.intrinsic.relight.provider = "ask".into();
        assert_eq!(of_materials(&s, all), []);
        assert_eq!(names(&of_materials(&s, FoundForMaterials { estimates: false, ..all })), ["relight"]);
        s.intrinsic.losses.own_prior = OwnPrior::Weight(0.2);
        let idle = of_materials(&s, FoundForMaterials { regions: false, ..all });
        assert_eq!(names(&idle), ["cross_view", "relight", "own_prior"]);
        assert_eq!(
            IdleLoss::warnings(&idle[..1])[0],
            "L_cross_semantic does not run: no regions; add priors/masks, semantic priors or provider.command, or set \
             intrinsic.losses.cross_view = 0"
        );
        s.intrinsic.steps = 10;
        assert_eq!(names(&of_materials(&s, all)), ["relight", "own_prior"]);
        // The paper's preset has the published losses only.
        let paper = Settings::from_table(Preset::find("paper").unwrap().table().unwrap()).unwrap();
        assert_eq!(paper.intrinsic.own_prior_weight(), 0.0);
        assert_eq!(names(&of_materials(&paper, all)), ["relight"]);
    }
}

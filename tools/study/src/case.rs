//! Cases of robustness: noise of one kind in the training inputs.

use super::Entry;
use super::variant::any;
use crate::error::{Result, StudyError};
use sgs_config::{NoiseSettings, Settings, ViewRates};
use sgs_scene::Scene;

/// Input that noise is added to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Input {
    Nothing,
    Positions,
    Normals,
    Semantics,
    Poses,
    /// Poses that training corrects.
    LearnedPoses,
}

/// Case of robustness.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Case {
    /// Name, as in `--only`.
    pub name: &'static str,
    input: Input,
}

const ALL: [Case; 6] = [
    Case { name: "clean", input: Input::Nothing },
    Case { name: "positions", input: Input::Positions },
    Case { name: "normals", input: Input::Normals },
    Case { name: "semantics", input: Input::Semantics },
    Case { name: "poses", input: Input::Poses },
    Case { name: "learned_poses", input: Input::LearnedPoses },
];

/// Noise of a case for which the settings have none of its kind. The paper gives no numbers.
const USUAL: NoiseSettings = NoiseSettings { positions: 0.01, normals: 10.0, semantics: 0.1, cameras: [0.5, 0.005] };

/// Learning rate of noisy cameras. It suffices for half a degree within 1000 steps.
const CAMERA_RATE: f64 = 1e-3;

impl Case {
    /// Returns every case, in the order of the paper's table. The case without noise is first.
    pub fn all() -> &'static [Case] {
        &ALL
    }

    /// Returns the cases of these names, in the order of the table. Returns all without names.
    ///
    /// # Errors
    /// If a case of a name does not exist. The error lists the names.
    pub fn named(names: &[String]) -> Result<Vec<Case>> {
        if let Some(name) = names.iter().find(|n| ALL.iter().all(|c| c.name != **n)) {
            let known = ALL.map(|c| c.name).join(", ");
            return Err(StudyError::UnknownRow { kind: "case", name: name.clone(), known });
        }
        Ok(ALL.into_iter().filter(|c| names.is_empty() || names.iter().any(|n| n == c.name)).collect())
    }

    /// Returns whether views are measured after alignment, too. Learned cameras leave the scene a little turned and
    /// shifted, so these cases are compared by that measure.
    pub fn aligns(&self) -> bool {
        matches!(self.input, Input::Nothing | Input::Poses | Input::LearnedPoses)
    }

    /// Returns settings with the noise of this case and no other. The amount is that of the settings, or the default of
    /// the case. Learned poses also have a learning rate.
    pub fn settings(&self, base: &Settings) -> Settings {
        let (requested, mut noise) = (&base.noise, NoiseSettings::default());
        let or = |requested: f64, usual: f64| if requested > 0.0 { requested } else { usual };
        match self.input {
            Input::Nothing => {}
            Input::Positions => noise.positions = or(requested.positions, USUAL.positions),
            Input::Normals => noise.normals = or(requested.normals, USUAL.normals),
            Input::Semantics => noise.semantics = or(requested.semantics, USUAL.semantics),
            // Settings with rotations alone, or translations alone, keep these.
            Input::Poses | Input::LearnedPoses if requested.cameras != [0.0; 2] => noise.cameras = requested.cameras,
            Input::Poses | Input::LearnedPoses => noise.cameras = USUAL.cameras,
        }
        let mut settings = Settings { noise, ..base.clone() };
        if self.input == Input::LearnedPoses {
            let [_, gains, lens, radial] = base.geometry.rates.views.fixed().unwrap_or_default();
            settings.geometry.rates.views = ViewRates::Fixed([CAMERA_RATE, gains, lens, radial]);
        }
        settings
    }

    /// Returns the row of a table. `base`: the settings that [`Case::settings`] takes.
    pub fn entry(&self, base: &Settings) -> Entry {
        let n = self.settings(base).noise;
        let share = |v: f64| format!("{} %", 100.0 * v);
        let about = match self.input {
            Input::Nothing => "everything as it is".to_owned(),
            Input::Positions => format!("initial points {} of the extent off", share(n.positions)),
            Input::Normals => format!("normal priors turned by {}°", n.normals),
            Input::Semantics => format!("{} of semantic cells wrong", share(n.semantics)),
            Input::Poses | Input::LearnedPoses => {
                let (turn, far) = (n.cameras[0], share(n.cameras[1]));
                let learned = if self.input == Input::LearnedPoses { ", and learned" } else { "" };
                format!("training cameras turned by {turn}°, {far} of the extent off{learned}")
            }
        };
        let order = ALL.iter().position(|c| c == self).unwrap_or(ALL.len());
        Entry { order, name: self.name, about, run: self.name }
    }

    /// Returns why the case would equal another one, as the end of a sentence. The scene may lack the input, or the
    /// settings may leave it out.
    ///
    /// # Errors
    /// If a prior cannot be read.
    pub fn lacks(&self, scene: &Scene, settings: &Settings) -> Result<Option<&'static str>> {
        let g = &settings.geometry;
        Ok(match self.input {
            Input::LearnedPoses if g.rates.views.fixed().is_some_and(|rates| rates[0] > 0.0) => {
                Some("geometry.rates.views learns cameras in every case")
            }
            Input::Nothing | Input::Positions | Input::Poses | Input::LearnedPoses => None,
            Input::Normals if !g.normals => Some("geometry.normals is false"),
            Input::Normals if !any(scene, |view| Ok(scene.normal_prior(view)?.is_some()))? => {
                Some("the scene has no priors/normal")
            }
            Input::Semantics if !g.semantics => Some("geometry.semantics is false"),
            Input::Semantics
                if scene.text_embeddings()?.is_none()
                    || !any(scene, |view| Ok(scene.semantic_prior(view)?.is_some()))? =>
            {
                Some("the scene has no priors/semantic")
            }
            Input::Normals | Input::Semantics => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_differ_only_in_noise() {
        let mut base = Settings { seed: 5, ..Settings::default() };
        base.noise.normals = 25.0;
        base.noise.cameras = [0.0, 0.03];
        let noise = |name: &str| {
            let case = ALL.iter().find(|c| c.name == name).unwrap();
            let mut settings = case.settings(&base);
            let noise = std::mem::replace(&mut settings.noise, base.noise);
            assert_eq!(settings, base, "{name}");
            noise
        };
        let none = NoiseSettings::default();
        assert_eq!(noise("clean"), none);
        assert_eq!(noise("positions"), NoiseSettings { positions: 0.01, ..none });
        assert_eq!(noise("normals"), NoiseSettings { normals: 25.0, ..none });
        assert_eq!(noise("semantics"), NoiseSettings { semantics: 0.1, ..none });
        assert_eq!(noise("poses"), NoiseSettings { cameras: [0.0, 0.03], ..none });
        assert_eq!(ALL.map(|c| c.aligns()), [true, false, false, false, true, true]);
        assert_eq!(ALL[2].entry(&base).about, "normal priors turned by 25°");
        assert_eq!(ALL[1].entry(&base).about, "initial points 1 % of the extent off");
    }

    #[test]
    fn learned_poses_are_poses_with_a_rate() {
        let [.., poses, learned] = ALL;
        assert_eq!((poses.name, learned.name), ("poses", "learned_poses"));
        let mut base = Settings::default();
        for (views, expected) in
            [(ViewRates::Auto, [1e-3, 0.0, 0.0, 0.0]), ([0.0, 5e-3, 2e-3, 4e-3].into(), [1e-3, 5e-3, 2e-3, 4e-3])]
        {
            base.geometry.rates.views = views;
            let mut settings = learned.settings(&base);
            assert_eq!(settings.geometry.rates.views, ViewRates::Fixed(expected));
            settings.geometry.rates.views = views;
            assert_eq!(settings, poses.settings(&base));
        }
        assert_eq!(learned.entry(&base).about, poses.entry(&base).about + ", and learned");
    }

    #[test]
    fn names_are_checked_and_ordered() {
        let names = |n: &[&str]| n.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let found = Case::named(&names(&["poses", "clean"])).unwrap();
        assert_eq!(found.iter().map(|c| c.name).collect::<Vec<_>>(), ["clean", "poses"]);
        let error = Case::named(&names(&["magic"])).unwrap_err().to_string();
        assert!(error.contains("there are clean, positions, normals, semantics, poses, learned_poses."), "{error}");
        assert!(error.contains("no case \"magic\"; "), "{error}");
    }
}

//! Presets: named base settings.
//!
//! Files, `--set` and options override them; a run records the result.

use crate::error::ConfigError;
use strsim::levenshtein;

/// Named base settings.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Name of the preset.
    pub name: &'static str,
    /// Purpose of the preset.
    pub about: &'static str,
    /// Settings of the preset as TOML.
    pub text: &'static str,
}

/// All presets.
pub const PRESETS: [Preset; 5] = [
    Preset { name: "draft", about: "quick, on a processor", text: include_str!("presets/draft.toml") },
    Preset { name: "fast", about: "images of the default in less time", text: include_str!("presets/fast.toml") },
    Preset { name: "default", about: "the defaults", text: "" },
    Preset { name: "paper", about: "the paper's sizes and weights", text: include_str!("presets/paper.toml") },
    Preset { name: "parity", about: "those of the published code", text: include_str!("presets/parity.toml") },
];

impl Preset {
    /// Returns a preset by its name.
    ///
    /// # Errors
    /// If no preset has this name. The sentence lists the most similar name and all names.
    pub fn find(name: &str) -> crate::Result<&'static Preset> {
        PRESETS.iter().find(|p| p.name == name).ok_or_else(|| {
            let near = PRESETS.iter().map(|p| (levenshtein(name, p.name), p.name)).min().filter(|(far, _)| *far <= 2);
            ConfigError::UnknownName {
                kind: "not a preset;",
                name: name.to_owned(),
                nearest: near.map(|(_, n)| n.to_owned()),
                known: PRESETS.map(|p| p.name.to_owned()).to_vec(),
            }
        })
    }

    /// Parses the settings of the preset.
    ///
    /// # Errors
    /// If the text is not TOML, which would be a defect.
    pub fn table(&self) -> crate::Result<toml::Table> {
        let wrong = |e: toml::de::Error| ConfigError::Format(format!("The preset \"{}\": {e}.", self.name));
        self.text.parse().map_err(wrong)
    }
}

/// Overrides the values of `table` with those of `over`, recursively.
pub fn overlay(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(value)) => overlay(inner, value),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DensifyRule, LobeLayout, Settings};

    fn of(name: &str) -> Settings {
        let settings = Settings::from_table(Preset::find(name).unwrap().table().unwrap()).unwrap();
        settings.check().unwrap();
        settings
    }

    #[test]
    fn presets_differ_and_have_their_published_values() {
        assert_eq!(of("default"), Settings::default());
        let all = PRESETS.map(|p| of(p.name));
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| a != b), "{} is another one", PRESETS[i].name);
        }
        let fast = of("fast");
        assert!(2 * fast.geometry.steps < 7000);
        let (draft, paper, parity) = (of("draft"), of("paper"), of("parity"));
        assert!(draft.geometry.steps < 7000 && draft.intrinsic.lights.grid == 3);
        assert_eq!((paper.intrinsic.environment.resolution, paper.intrinsic.visibility.log2_table), (512, 19));
        assert_eq!((paper.intrinsic.losses.albedo, parity.intrinsic.losses.albedo), (0.3, 0.3));
        let semantic = |s: &Settings| {
            let l = &s.geometry.losses;
            [l.semantic, l.semantic_class, l.correspondence]
        };
        assert_eq!([semantic(&paper), semantic(&parity)], [[1.0, 1.0, 0.3]; 2]);
        assert_eq!(semantic(&draft), [0.02, 0.02, 0.006]);
        for published in [&paper, &parity] {
            assert_eq!((published.geometry.coarse, published.geometry.densify.from), (0.0, 500));
        }
        // Nothing reduces the environment map, and its smoothness loss has a weight.
        assert!(!paper.intrinsic.automatic.enabled && paper.intrinsic.losses.environment_smooth == 0.01);
        assert_eq!([paper.intrinsic.albedo_range, parity.intrinsic.albedo_range], [[0.09, 0.99]; 2]);
        assert_eq!(parity.geometry.densify.rule, DensifyRule::Geometric);
        assert_eq!((parity.intrinsic.lights.layout, parity.intrinsic.visibility.coarsest), (LobeLayout::Grid, 16));
    }

    #[test]
    fn unknown_presets_get_a_suggestion() {
        let error = |name: &str| Preset::find(name).unwrap_err().to_string();
        assert_eq!(
            error("papr"),
            "\"papr\" is not a preset; did you mean \"paper\"? there are draft, fast, default, paper, parity."
        );
        assert_eq!(
            error("fast and good"),
            "\"fast and good\" is not a preset; there are draft, fast, default, paper, parity."
        );
    }

    #[test]
    fn overlay_overrides_the_preset() {
        let mut table = Preset::find("parity").unwrap().table().unwrap();
        overlay(&mut table, "seed = 3\n[intrinsic.visibility]\ncoarsest = 20".parse().unwrap());
        let s = Settings::from_table(table).unwrap();
        let v = s.intrinsic.visibility;
        assert_eq!((s.seed, v.coarsest, v.log2_table, s.geometry.dense_adam), (3, 20, 18, true));
    }
}

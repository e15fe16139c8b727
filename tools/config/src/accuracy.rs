//! Accuracy that is traded for speed, as settings.

use crate::error::ConfigError;
use sgs_passes::Accuracy;
use strsim::levenshtein;

/// Named accuracy level. Does not change the size of the model.
struct Level {
    name: &'static str,
    accuracy: Accuracy,
    /// `intrinsic.environment.every`.
    every: u32,
    /// `intrinsic.visibility.sample`.
    sample: u32,
}

/// All accuracy levels.
const LEVELS: [Level; 4] = [
    Level { name: "exact", accuracy: Accuracy::EXACT, every: 1, sample: 1 },
    Level { name: "compact", accuracy: Accuracy::COMPACT, every: 1, sample: 1 },
    Level { name: "balanced", accuracy: Accuracy::BALANCED, every: 4, sample: 4 },
    Level { name: "fast", accuracy: Accuracy::FAST, every: 4, sample: 4 },
];

/// Names of the accuracy levels.
pub const ACCURACY_LEVELS: [&str; LEVELS.len()] = [LEVELS[0].name, LEVELS[1].name, LEVELS[2].name, LEVELS[3].name];

/// Returns the settings of an accuracy level: `exact`, `compact`, `balanced` or `fast`.
///
/// Sets `[accuracy]`, the update interval of the environment map, and the sampling of visibility pairs.
///
/// # Errors
/// If the level does not exist.
pub fn accuracy_named(name: &str) -> crate::Result<toml::Table> {
    if let Some(level) = LEVELS.iter().find(|level| level.name == name) {
        let &Level { accuracy, every, sample, .. } = level;
        let written = |e: String| ConfigError::Format(format!("The accuracy \"{name}\" cannot be written: {e}."));
        let text = format!("[intrinsic]\nenvironment = {{ every = {every} }}\nvisibility = {{ sample = {sample} }}\n");
        let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| written(e.to_string()))?;
        let accuracy = toml::Value::try_from(accuracy).map_err(|e| written(e.to_string()))?;
        table.insert("accuracy".to_owned(), accuracy);
        return Ok(table);
    }
    let known = LEVELS.map(|level| level.name.to_owned());
    Err(ConfigError::UnknownName {
        kind: "no accuracy;",
        name: name.to_owned(),
        nearest: known.iter().find(|n| levenshtein(n, name) <= 2).cloned(),
        known: known.to_vec(),
    })
}

/// Refuses values that kernels do not support.
pub(super) fn check(a: &Accuracy) -> crate::Result<()> {
    if ![16, 24, 31].contains(&a.depth_bits) {
        return Err(ConfigError::range("accuracy.depth_bits", a.depth_bits, "16, 24 or 31"));
    }
    if !(1e-4..=0.1).contains(&a.alpha_min) {
        return Err(ConfigError::range("accuracy.alpha_min", a.alpha_min, "0.0001 to 0.1"));
    }
    if !(1e-8..=0.5).contains(&a.transmittance_min) {
        return Err(ConfigError::range("accuracy.transmittance_min", a.transmittance_min, "0.00000001 to 0.5"));
    }
    for (name, bits) in [
        ("visibility_bits", a.visibility_bits),
        ("color_bits", a.color_bits),
        ("weight_bits", a.weight_bits),
        ("state_bits", a.state_bits),
    ] {
        if ![16, 32].contains(&bits) {
            return Err(ConfigError::range(format_args!("accuracy.{name}"), bits, "16 or 32"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    #[test]
    fn unknown_accuracy_levels_get_a_suggestion() {
        let of = |name: &str| Settings::from_table(accuracy_named(name).unwrap()).unwrap();
        assert_eq!(of("exact"), Settings::default());
        let (compact, balanced, fast) = (of("compact"), of("balanced"), of("fast"));
        assert_eq!((balanced.accuracy, fast.accuracy), (Accuracy::BALANCED, Accuracy::FAST));
        assert_eq!(compact, Settings { accuracy: Accuracy { state_bits: 16, ..Accuracy::EXACT }, ..of("exact") });
        assert_eq!((fast.intrinsic.environment.every, fast.intrinsic.visibility.sample), (4, 4));
        // The size of the model does not depend on the level.
        let same = |mut s: Settings| {
            (s.accuracy, s.intrinsic.environment.every, s.intrinsic.visibility.sample) = (Accuracy::EXACT, 1, 1);
            s == Settings::default()
        };
        assert!(same(balanced) && same(fast));
        // All levels have the same keys, so that one level overrides another completely.
        let keys = |name: &str| {
            let t = accuracy_named(name).unwrap();
            let inner = |k: &str| t["accuracy"].get(k).is_some();
            (t["accuracy"].as_table().unwrap().len(), inner("weight_bits"), t["intrinsic"].as_table().unwrap().len())
        };
        assert!(ACCURACY_LEVELS.iter().all(|name| keys(name) == (8, true, 2)));
        let message = |n: &str| accuracy_named(n).unwrap_err().to_string();
        assert_eq!(
            message("exat"),
            "\"exat\" is no accuracy; did you mean \"exact\"? there are exact, compact, balanced, fast."
        );
        assert_eq!(message("sloppy"), "\"sloppy\" is no accuracy; there are exact, compact, balanced, fast.");
    }

    #[test]
    fn unsupported_accuracy_values_are_refused() {
        let good = Accuracy::default();
        check(&good).unwrap();
        for bad in [
            Accuracy { depth_bits: 20, ..good },
            Accuracy { alpha_min: 0.0, ..good },
            Accuracy { alpha_min: f32::NAN, ..good },
            Accuracy { transmittance_min: 0.6, ..good },
            Accuracy { visibility_bits: 24, ..good },
            Accuracy { color_bits: 24, ..good },
            Accuracy { weight_bits: 0, ..good },
            Accuracy { state_bits: 8, ..good },
        ] {
            assert!(check(&bad).unwrap_err().to_string().starts_with("accuracy."));
        }
    }
}

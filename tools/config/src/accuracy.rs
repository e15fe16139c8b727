//! Accuracy that is traded for speed, as settings.

use super::distance;
use crate::error::ConfigError;
use sgs_passes::Accuracy;

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
const LEVELS: [Level; 3] = [
    Level { name: "exact", accuracy: Accuracy::EXACT, every: 1, sample: 1 },
    Level { name: "balanced", accuracy: Accuracy::BALANCED, every: 4, sample: 4 },
    Level { name: "fast", accuracy: Accuracy::FAST, every: 4, sample: 4 },
];

/// Returns the settings of an accuracy level: `exact`, `balanced` or `fast`.
///
/// Sets `[accuracy]`, the update interval of the environment map, and the sampling of visibility pairs.
///
/// # Errors
/// If the level does not exist.
pub fn accuracy_named(name: &str) -> crate::Result<toml::Table> {
    if let Some(level) = LEVELS.iter().find(|level| level.name == name) {
        let &Level { accuracy, every, sample, .. } = level;
        let written = |e: String| ConfigError::new(format!("The accuracy \"{name}\" cannot be written: {e}."));
        let text = format!("[intrinsic]\nenvironment = {{ every = {every} }}\nvisibility = {{ sample = {sample} }}\n");
        let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| written(e.to_string()))?;
        let accuracy = toml::Value::try_from(accuracy).map_err(|e| written(e.to_string()))?;
        table.insert("accuracy".to_owned(), accuracy);
        return Ok(table);
    }
    let near = LEVELS.iter().map(|level| level.name).find(|n| distance(n, name) <= 2);
    let hint = near.map(|n| format!("did you mean \"{n}\"? ")).unwrap_or_default();
    Err(ConfigError::new(format!("\"{name}\" is no accuracy; {hint}there are exact, balanced, fast.")))
}

/// Refuses values that kernels do not support.
pub(super) fn check(a: &Accuracy) -> crate::Result<()> {
    let fail = |what: String| Err(ConfigError::new(what));
    if ![16, 24, 31].contains(&a.depth_bits) {
        return fail(format!("accuracy.depth_bits is {}, but must be 16, 24 or 31.", a.depth_bits));
    }
    if !(1e-4..=0.1).contains(&a.alpha_min) {
        return fail(format!("accuracy.alpha_min is {}, but must be 0.0001 to 0.1.", a.alpha_min));
    }
    if !(1e-8..=0.5).contains(&a.transmittance_min) {
        return fail(format!("accuracy.transmittance_min is {}, but must be 0.00000001 to 0.5.", a.transmittance_min));
    }
    for (name, bits) in [
        ("visibility_operands", a.visibility_operands),
        ("color_bits", a.color_bits),
        ("table_bits", a.table_bits),
        ("weight_bits", a.weight_bits),
    ] {
        if ![16, 32].contains(&bits) {
            return fail(format!("accuracy.{name} is {bits}, but must be 16 or 32."));
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
        let (balanced, fast) = (of("balanced"), of("fast"));
        assert_eq!((balanced.accuracy, fast.accuracy), (Accuracy::BALANCED, Accuracy::FAST));
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
        assert!(keys("exact") == keys("balanced") && keys("exact") == keys("fast") && keys("exact") == (8, true, 2));
        let message = |n: &str| accuracy_named(n).unwrap_err().to_string();
        assert_eq!(
            message("exat"),
            "\"exat\" is no accuracy; did you mean \"exact\"? there are exact, balanced, fast."
        );
        assert_eq!(message("sloppy"), "\"sloppy\" is no accuracy; there are exact, balanced, fast.");
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
            Accuracy { visibility_operands: 24, ..good },
            Accuracy { color_bits: 24, ..good },
            Accuracy { table_bits: 8, ..good },
            Accuracy { weight_bits: 0, ..good },
        ] {
            assert!(check(&bad).unwrap_err().to_string().starts_with("accuracy."));
        }
    }
}

//! What is traded for speed, as settings.

use super::distance;
use crate::error::TrainError;
use sgs_passes::Accuracy;

/// The named ones.
const LEVELS: [(&str, Accuracy); 3] =
    [("exact", Accuracy::EXACT), ("balanced", Accuracy::BALANCED), ("fast", Accuracy::FAST)];

/// `exact`, `balanced` or `fast`.
///
/// # Errors
/// If it is none of these.
pub fn accuracy_named(name: &str) -> crate::Result<Accuracy> {
    if let Some((_, a)) = LEVELS.iter().find(|(n, _)| *n == name) {
        return Ok(*a);
    }
    let near = LEVELS.iter().map(|(n, _)| *n).find(|n| distance(n, name) <= 2);
    let hint = near.map(|n| format!("did you mean \"{n}\"? ")).unwrap_or_default();
    Err(TrainError::Setting(format!("\"{name}\" is no accuracy; {hint}there are exact, balanced, fast.")))
}

/// What cannot be meant.
pub(super) fn check(a: &Accuracy) -> crate::Result<()> {
    let fail = |what: String| Err(TrainError::Setting(what));
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
        ("feature_bits", a.feature_bits),
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

    #[test]
    fn names_are_known_or_hinted_at() {
        assert_eq!(accuracy_named("exact").unwrap(), Accuracy::default());
        assert_eq!(accuracy_named("fast").unwrap(), Accuracy::FAST);
        let message = |n: &str| accuracy_named(n).unwrap_err().to_string();
        assert_eq!(
            message("exat"),
            "\"exat\" is no accuracy; did you mean \"exact\"? there are exact, balanced, fast."
        );
        assert_eq!(message("sloppy"), "\"sloppy\" is no accuracy; there are exact, balanced, fast.");
    }

    #[test]
    fn what_kernels_cannot_do_is_refused() {
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
            Accuracy { feature_bits: 64, ..good },
        ] {
            assert!(check(&bad).unwrap_err().to_string().starts_with("accuracy."));
        }
    }
}

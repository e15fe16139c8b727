//! What is traded for speed, as settings.

use super::distance;
use crate::error::TrainError;
use serde::{Deserialize, Serialize};
use sgs_passes::Accuracy;

/// What may be traded for speed ([`Accuracy`]). Measures of a run are always exact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AccuracySettings {
    /// Bits of the keys that splats are sorted by along the view: 31, 24 or 16.
    pub depth_bits: u32,
    /// Smallest opacity of a splat at a pixel that counts.
    pub alpha_min: f32,
    /// A pixel stops where less than this would be left to be seen behind it.
    pub transmittance_min: f32,
    /// Whether the splat with which a pixel stops is blended.
    pub keep_last: bool,
    /// Whether a cubic stands in for the exponential.
    pub fast_exp: bool,
    /// Bits of the numbers that the visibility field's second layer multiplies: 32, or 16 where there are matrix units.
    pub visibility_operands: u32,
    /// Bits of a channel of splats' colors between projection and blending: 32 or 16.
    pub color_bits: u32,
    /// Bits of the visibility field's tables where they are looked up: 32 or 16.
    pub table_bits: u32,
    /// Bits of the weights of the intrinsic stage's pixels: 32 or 16.
    pub weight_bits: u32,
    /// Bits of semantic features where blending reads them: 32 or 16.
    pub feature_bits: u32,
}

/// The named ones.
const LEVELS: [(&str, Accuracy); 3] =
    [("exact", Accuracy::EXACT), ("balanced", Accuracy::BALANCED), ("fast", Accuracy::FAST)];

impl Default for AccuracySettings {
    fn default() -> Self {
        Accuracy::EXACT.into()
    }
}

impl From<Accuracy> for AccuracySettings {
    fn from(a: Accuracy) -> Self {
        let Accuracy {
            depth_bits,
            alpha_min,
            transmittance_min,
            keep_last,
            fast_exp,
            visibility_operands,
            color_bits,
            table_bits,
            weight_bits,
            feature_bits,
        } = a;
        AccuracySettings {
            depth_bits,
            alpha_min,
            transmittance_min,
            keep_last,
            fast_exp,
            visibility_operands,
            color_bits,
            table_bits,
            weight_bits,
            feature_bits,
        }
    }
}

impl From<AccuracySettings> for Accuracy {
    fn from(s: AccuracySettings) -> Self {
        let AccuracySettings {
            depth_bits,
            alpha_min,
            transmittance_min,
            keep_last,
            fast_exp,
            visibility_operands,
            color_bits,
            table_bits,
            weight_bits,
            feature_bits,
        } = s;
        Accuracy {
            depth_bits,
            alpha_min,
            transmittance_min,
            keep_last,
            fast_exp,
            visibility_operands,
            color_bits,
            table_bits,
            weight_bits,
            feature_bits,
        }
    }
}

impl AccuracySettings {
    /// `exact`, `balanced` or `fast`.
    ///
    /// # Errors
    /// If it is none of these.
    pub fn named(name: &str) -> crate::Result<AccuracySettings> {
        if let Some((_, a)) = LEVELS.iter().find(|(n, _)| *n == name) {
            return Ok((*a).into());
        }
        let near = LEVELS.iter().map(|(n, _)| *n).find(|n| distance(n, name) <= 2);
        let hint = near.map(|n| format!("did you mean \"{n}\"? ")).unwrap_or_default();
        Err(TrainError::Setting(format!("\"{name}\" is no accuracy; {hint}there are exact, balanced, fast.")))
    }

    pub(super) fn check(&self) -> crate::Result<()> {
        let fail = |what: String| Err(TrainError::Setting(what));
        if ![16, 24, 31].contains(&self.depth_bits) {
            return fail(format!("accuracy.depth_bits is {}, but must be 16, 24 or 31.", self.depth_bits));
        }
        if !(1e-4..=0.1).contains(&self.alpha_min) {
            return fail(format!("accuracy.alpha_min is {}, but must be 0.0001 to 0.1.", self.alpha_min));
        }
        if !(1e-8..=0.5).contains(&self.transmittance_min) {
            return fail(format!(
                "accuracy.transmittance_min is {}, but must be 0.00000001 to 0.5.",
                self.transmittance_min
            ));
        }
        for (name, bits) in [
            ("visibility_operands", self.visibility_operands),
            ("color_bits", self.color_bits),
            ("table_bits", self.table_bits),
            ("weight_bits", self.weight_bits),
            ("feature_bits", self.feature_bits),
        ] {
            if ![16, 32].contains(&bits) {
                return fail(format!("accuracy.{name} is {bits}, but must be 16 or 32."));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_known_or_hinted_at() {
        assert_eq!(AccuracySettings::named("exact").unwrap(), AccuracySettings::default());
        assert_eq!(Accuracy::from(AccuracySettings::named("fast").unwrap()), Accuracy::FAST);
        let message = |n: &str| AccuracySettings::named(n).unwrap_err().to_string();
        assert_eq!(
            message("exat"),
            "\"exat\" is no accuracy; did you mean \"exact\"? there are exact, balanced, fast."
        );
        assert_eq!(message("sloppy"), "\"sloppy\" is no accuracy; there are exact, balanced, fast.");
    }

    #[test]
    fn what_kernels_cannot_do_is_refused() {
        let good = AccuracySettings::default();
        good.check().unwrap();
        for bad in [
            AccuracySettings { depth_bits: 20, ..good },
            AccuracySettings { alpha_min: 0.0, ..good },
            AccuracySettings { alpha_min: f32::NAN, ..good },
            AccuracySettings { transmittance_min: 0.6, ..good },
            AccuracySettings { visibility_operands: 24, ..good },
            AccuracySettings { color_bits: 24, ..good },
            AccuracySettings { table_bits: 8, ..good },
            AccuracySettings { weight_bits: 0, ..good },
            AccuracySettings { feature_bits: 64, ..good },
        ] {
            assert!(bad.check().unwrap_err().to_string().starts_with("accuracy."));
        }
    }
}

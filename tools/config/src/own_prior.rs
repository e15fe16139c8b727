//! Weight of the loss of a region's albedo against the view's own prior.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub(super) const AUTO: &str = "auto";

/// Weight of a region's albedo against the view's own prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OwnPrior {
    /// Weight of `relight` without a provider of materials, else 0.
    Auto,
    /// Fixed weight.
    Weight(f32),
}

impl Serialize for OwnPrior {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self {
            OwnPrior::Weight(weight) => s.serialize_f32(*weight),
            OwnPrior::Auto => s.serialize_str(AUTO),
        }
    }
}

impl<'de> Deserialize<'de> for OwnPrior {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<OwnPrior, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Whole(i64),
            Number(f32),
            Word(String),
        }
        match Either::deserialize(d) {
            Ok(Either::Whole(weight)) => Ok(OwnPrior::Weight(weight as f32)),
            Ok(Either::Number(weight)) => Ok(OwnPrior::Weight(weight)),
            Ok(Either::Word(word)) if word == AUTO => Ok(OwnPrior::Auto),
            _ => Err(D::Error::custom("expected a number of at least 0 or \"auto\"")),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{OwnPrior, Settings};

    #[test]
    fn own_prior_is_a_number_or_auto() {
        let of = |text: &str| {
            let table = format!("[intrinsic.losses]\nown_prior = {text}").parse::<toml::Table>().unwrap();
            Settings::from_table(table).map(|s| s.intrinsic.losses.own_prior)
        };
        assert_eq!(of("0.25").unwrap(), OwnPrior::Weight(0.25));
        assert_eq!(of("1").unwrap(), OwnPrior::Weight(1.0));
        assert_eq!(of("\"auto\"").unwrap(), OwnPrior::Auto);
        for wrong in ["-0.5", "nan", "\"own\"", "-1", "true"] {
            let error = of(wrong).unwrap_err().to_string();
            assert!(error.contains("intrinsic.losses.own_prior is ") && error.contains("at least 0"), "{error}");
        }
        // A recorded value parses to the same value.
        for text in ["0.25", "\"auto\""] {
            let losses = crate::IntrinsicLosses { own_prior: of(text).unwrap(), ..Default::default() };
            let table = toml::Table::try_from(losses).unwrap();
            assert_eq!(table.try_into::<crate::IntrinsicLosses>().unwrap(), losses);
        }
        // The default: the weight of `relight`, unless a provider is set.
        let mut s = Settings::default().intrinsic;
        assert_eq!((s.own_prior_weight(), s.relight_weight()), (0.4, 0.0));
        s.relight.provider = "ask".into();
        assert_eq!((s.own_prior_weight(), s.relight_weight()), (0.0, 0.4));
    }
}

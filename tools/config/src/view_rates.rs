//! Rates at which cameras, exposures and the lens of photographs are learned: four numbers, or `auto`.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub(super) const AUTO: &str = "auto";

/// Rates of what is learned of the photographs; in files four numbers or the word `auto`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ViewRates {
    /// Measured before training: [`ViewRates::RECORDING`] or nothing.
    ///
    /// The depths of a sensor show whether photographs disagree.
    Auto,
    /// Fixed rates: of cameras, exposures, lens and radial distortion; 0 learns nothing.
    Fixed([f64; 4]),
}

impl ViewRates {
    /// Rates that `auto` takes for a recording: cameras of a tracker, automatic exposure, a lens that was not calibrated.
    pub const RECORDING: [f64; 4] = [3e-4, 5e-3, 2e-3, 1e-3];

    /// Returns the fixed rates. `auto` has none before the scene was measured.
    pub fn fixed(self) -> Option<[f64; 4]> {
        match self {
            ViewRates::Fixed(rates) => Some(rates),
            ViewRates::Auto => None,
        }
    }
}

impl From<[f64; 4]> for ViewRates {
    fn from(rates: [f64; 4]) -> ViewRates {
        ViewRates::Fixed(rates)
    }
}

impl Serialize for ViewRates {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self {
            ViewRates::Fixed(rates) => rates.serialize(s),
            ViewRates::Auto => s.serialize_str(AUTO),
        }
    }
}

impl<'de> Deserialize<'de> for ViewRates {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<ViewRates, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Numbers([f64; 4]),
            Word(String),
        }
        match Either::deserialize(d) {
            Ok(Either::Numbers(rates)) => Ok(ViewRates::Fixed(rates)),
            Ok(Either::Word(word)) if word == AUTO => Ok(ViewRates::Auto),
            _ => Err(serde::de::Error::custom("expected 4 numbers or \"auto\"")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    #[test]
    fn view_rates_are_four_numbers_or_auto() {
        let of = |text: &str| {
            let table = format!("[geometry.rates]\nviews = {text}").parse().unwrap();
            Settings::from_table(table).and_then(|s| s.check().map(|()| s))
        };
        let rates = |text: &str| of(text).map(|s| s.geometry.rates.views);
        assert_eq!(rates("[1e-3, 0, 2, 0.5]").unwrap(), ViewRates::Fixed([1e-3, 0.0, 2.0, 0.5]));
        assert_eq!(rates("\"auto\"").unwrap(), ViewRates::Auto);
        assert_eq!((ViewRates::Auto.fixed(), ViewRates::from([1.0; 4]).fixed()), (None, Some([1.0; 4])));
        for text in ["[1e-3, 0, 2, 0.5]", "\"auto\""] {
            let s = of(text).unwrap();
            assert_eq!(Settings::from_table(s.to_table().unwrap()).unwrap(), s);
        }
        for wrong in ["\"on\"", "[1, 2, 3]", "1e-3", "true", "[1, 2, 3, \"auto\"]"] {
            let error = rates(wrong).unwrap_err().to_string();
            assert!(
                error.starts_with("geometry.rates.views is ") && error.ends_with("4 numbers or \"auto\"."),
                "{error}"
            );
        }
        for wrong in ["[0, 0, 0, -1]", "[inf, 0, 0, 0]"] {
            assert!(rates(wrong).unwrap_err().to_string().contains("a finite number of at least 0"));
        }
    }
}

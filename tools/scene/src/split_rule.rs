//! Rules that split views into training and test views.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::SceneError;

/// Rule that splits views into training and test views. Views are numbered from 0 in the order of their names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum SplitRule {
    /// `auto`: `split.json` of the scene, else the layout's split, else every 8th view.
    #[default]
    Auto,
    /// `every:N`: views 0, N, 2N and so on are test views. This matches 3DGS and MipNeRF-360.
    Every(usize),
    /// `linspace:N`: N test views, spread evenly. The positions go from the second view to the last but one and are
    /// rounded down.
    Linspace(usize),
    /// Path of a file in the format of `split.json`.
    File(PathBuf),
}

const EXPECTED: &str =
    "a split is auto, every:N with N of at least 2, linspace:N with N of at least 1, or a file like split.json";

impl FromStr for SplitRule {
    type Err = SceneError;

    fn from_str(text: &str) -> Result<Self, SceneError> {
        let wrong = || SceneError::Option { option: "--split", value: format!("\"{text}\""), expected: EXPECTED };
        let number = |digits: &str, least: usize| digits.parse().ok().filter(|n| *n >= least).ok_or_else(wrong);
        match text.split_once(':') {
            Some(("every", n)) => number(n, 2).map(Self::Every),
            Some(("linspace", n)) => number(n, 1).map(Self::Linspace),
            _ if text == "auto" => Ok(Self::Auto),
            _ if text.is_empty() => Err(wrong()),
            _ => Ok(Self::File(PathBuf::from(text))),
        }
    }
}

impl fmt::Display for SplitRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Every(n) => write!(f, "every:{n}"),
            Self::Linspace(n) => write!(f, "linspace:{n}"),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

impl Serialize for SplitRule {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for SplitRule {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        let wrong = || serde::de::Error::custom(format!("split: {EXPECTED}"));
        let text = String::deserialize(d).map_err(|_| wrong())?;
        text.parse().map_err(|_| wrong())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_round_trip_through_text() {
        for (text, rule) in [
            ("auto", SplitRule::Auto),
            ("every:8", SplitRule::Every(8)),
            ("linspace:5", SplitRule::Linspace(5)),
            ("folds/first.json", SplitRule::File("folds/first.json".into())),
        ] {
            assert_eq!(text.parse::<SplitRule>().unwrap(), rule);
            assert_eq!(rule.to_string(), text);
        }
    }

    #[test]
    fn invalid_rules_are_rejected() {
        for text in ["", "every:1", "every:", "every:-8", "linspace:0", "linspace:x"] {
            let error = text.parse::<SplitRule>().unwrap_err().to_string();
            assert!(error.starts_with(&format!("--split is \"{text}\", but a split is auto, every:N")), "{error}");
        }
    }
}

//! Use of the masks of a data set.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Use of the masks of valid pixels; in files `true`, `false`, or the word `inverted`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskUse {
    /// White pixels are valid; others have no losses and are not measured.
    #[default]
    Valid,
    /// White pixels are invalid.
    Inverted,
    /// All pixels are valid.
    Ignored,
}

impl MaskUse {
    /// Word for inverted masks.
    pub const INVERTED: &str = "inverted";
}

impl Serialize for MaskUse {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Valid => s.serialize_bool(true),
            Self::Ignored => s.serialize_bool(false),
            Self::Inverted => s.serialize_str(Self::INVERTED),
        }
    }
}

impl<'de> Deserialize<'de> for MaskUse {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Switch(bool),
            Word(String),
        }
        match Either::deserialize(d) {
            Ok(Either::Switch(true)) => Ok(Self::Valid),
            Ok(Either::Switch(false)) => Ok(Self::Ignored),
            Ok(Either::Word(word)) if word == Self::INVERTED => Ok(Self::Inverted),
            _ => Err(serde::de::Error::custom("masks must be true, false or \"inverted\"")),
        }
    }
}

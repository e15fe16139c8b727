//! Degree of spherical harmonics: a number, or `auto` to measure it.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Word for a measured degree.
pub(super) const AUTO: &str = "auto";

/// Maximum number of bands besides band 0.
pub const MOST_BANDS: u32 = 3;

/// Degree of spherical harmonics; in files a number or the word `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShDegree {
    /// Fixed degree from the first step on.
    Fixed(u32),
    /// Starts at degree 0. Keeps a band if its measured PSNR gain is large enough.
    Auto,
}

impl ShDegree {
    /// Returns the initial degree.
    pub fn start(self) -> u32 {
        match self {
            ShDegree::Fixed(degree) => degree,
            ShDegree::Auto => 0,
        }
    }

    /// Returns the maximum degree.
    pub fn most(self) -> u32 {
        match self {
            ShDegree::Fixed(degree) => degree,
            ShDegree::Auto => MOST_BANDS,
        }
    }
}

impl From<u32> for ShDegree {
    fn from(degree: u32) -> ShDegree {
        ShDegree::Fixed(degree)
    }
}

impl std::fmt::Display for ShDegree {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ShDegree::Fixed(degree) => write!(f, "{degree}"),
            ShDegree::Auto => f.write_str(AUTO),
        }
    }
}

impl Serialize for ShDegree {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self {
            ShDegree::Fixed(degree) => s.serialize_u32(*degree),
            ShDegree::Auto => s.serialize_str(AUTO),
        }
    }
}

impl<'de> Deserialize<'de> for ShDegree {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<ShDegree, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Number(u32),
            Word(Word),
        }
        #[derive(Deserialize)]
        #[serde(rename_all = "lowercase")]
        enum Word {
            Auto,
        }
        match Either::deserialize(d) {
            Ok(Either::Number(degree)) => Ok(ShDegree::Fixed(degree)),
            Ok(Either::Word(Word::Auto)) => Ok(ShDegree::Auto),
            Err(_) => Err(serde::de::Error::custom("geometry.sh_degree must be 0 to 3, or \"auto\"")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    #[test]
    fn sh_degree_is_a_number_or_auto() {
        let of = |text: &str| Settings::from_table(text.parse().unwrap()).and_then(|s| s.check().map(|()| s));
        let degree = |text: &str| of(&format!("[geometry]\nsh_degree = {text}")).map(|s| s.geometry.sh_degree);
        assert_eq!(degree("2").unwrap(), ShDegree::Fixed(2));
        assert_eq!(degree("\"auto\"").unwrap(), ShDegree::Auto);
        let mut s = Settings::default();
        for d in [ShDegree::Auto, ShDegree::Fixed(0)] {
            s.geometry.sh_degree = d;
            assert_eq!(of(&toml::to_string(&s).unwrap()).unwrap(), s);
        }
        for (wrong, is) in [("\"automatic\"", "\"automatic\""), ("1.5", "1.5"), ("true", "true")] {
            let error = degree(wrong).unwrap_err().to_string();
            assert_eq!(error, format!("geometry.sh_degree is {is}, but must be 0 to 3 or \"auto\"."));
        }
        assert_eq!(degree("4").unwrap_err().to_string(), "geometry.sh_degree is 4, but must be 0 to 3 or \"auto\".");
        assert_eq!(degree("-1").unwrap_err().to_string(), "geometry.sh_degree is -1, but must be at least 0.");
        assert_eq!((ShDegree::Auto.start(), ShDegree::Auto.most(), ShDegree::from(1).most()), (0, 3, 1));
    }
}

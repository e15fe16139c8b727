//! Settings of automatic model selection in the intrinsic stage.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Automatic model selection (docs/how/model.md).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutomaticSettings {
    /// Selects parts by measurement. The other settings are then upper bounds.
    pub enabled: bool,
    /// Parts that selection may remove or reduce; all by default. `sizes`: of environment map and visibility field, by
    /// the cameras.
    pub parts: Parts,
    /// PSNR gain in dB of the shaded image that keeps a part.
    pub gain: f32,
    /// Two bounds of the images with which parts are measured, in dB. The first is the largest deficit of shaded images,
    /// relative to images of the Gaussians' own colors. The second is the largest change since the previous measurement;
    /// it holds for lobes, levels and the update interval.
    pub limits: [f32; 2],
}

impl Default for AutomaticSettings {
    fn default() -> Self {
        AutomaticSettings { enabled: false, parts: Parts::ALL, gain: 0.02, limits: [8.0, 0.3] }
    }
}

/// Parts of the model that selection may remove or reduce; in files a list of their names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    /// Sizes of environment map and visibility field, by the cameras.
    pub sizes: bool,
    /// Metallic, by its priors.
    pub metallic: bool,
    /// Lights.
    pub lights: bool,
    /// Lobes of lights, which are merged.
    pub lobes: bool,
    /// Environment map.
    pub environment: bool,
    /// Visibility.
    pub visibility: bool,
    /// Finest levels of the visibility field.
    pub levels: bool,
    /// Texels of the environment map.
    pub texels: bool,
    /// Update interval of the environment map.
    pub update_interval: bool,
}

impl Parts {
    /// All parts.
    pub const ALL: Parts = Parts {
        sizes: true,
        metallic: true,
        lights: true,
        lobes: true,
        environment: true,
        visibility: true,
        levels: true,
        texels: true,
        update_interval: true,
    };

    /// No part.
    pub const NONE: Parts = Parts {
        sizes: false,
        metallic: false,
        lights: false,
        lobes: false,
        environment: false,
        visibility: false,
        levels: false,
        texels: false,
        update_interval: false,
    };

    /// Returns name and field of each part.
    fn named(&mut self) -> [(&'static str, &mut bool); 9] {
        let Parts { sizes, metallic, lights, lobes, environment, visibility, levels, texels, update_interval } = self;
        [
            ("sizes", sizes),
            ("metallic", metallic),
            ("lights", lights),
            ("lobes", lobes),
            ("environment", environment),
            ("visibility", visibility),
            ("levels", levels),
            ("texels", texels),
            ("update_interval", update_interval),
        ]
    }
}

impl Serialize for Parts {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut parts = *self;
        s.collect_seq(parts.named().into_iter().filter(|(_, on)| **on).map(|(name, _)| name))
    }
}

impl<'de> Deserialize<'de> for Parts {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Parts, D::Error> {
        let mut parts = Parts::NONE;
        for name in Vec::<String>::deserialize(d)? {
            match parts.named().into_iter().find(|(known, _)| *known == name) {
                Some((_, on)) => *on = true,
                None => return Err(D::Error::custom(format!("there is no part \"{name}\""))),
            }
        }
        Ok(parts)
    }
}

#[cfg(test)]
mod tests {
    use super::Parts;
    use crate::Settings;

    #[test]
    fn parts_are_a_list_of_names() {
        let of = |list: &str| {
            let table = format!("[intrinsic.automatic]\nparts = {list}").parse().unwrap();
            Settings::from_table(table).map(|s| s.intrinsic.automatic.parts)
        };
        assert_eq!(of("[]").unwrap(), Parts::NONE);
        assert_eq!(of("[\"lobes\", \"sizes\"]").unwrap(), Parts { sizes: true, lobes: true, ..Parts::NONE });
        let written = toml::Value::try_from(Settings::default()).unwrap();
        assert_eq!(written["intrinsic"]["automatic"]["parts"].as_array().unwrap().len(), 9);
        let error = of("[\"lobe\"]").unwrap_err().to_string();
        assert_eq!(
            error,
            "intrinsic.automatic.parts has \"lobe\", but must be a list of sizes, metallic, lights, lobes, environment, \
             visibility, levels, texels, update_interval."
        );
        assert!(of("[1]").unwrap_err().to_string().contains("must be a list of sizes"));
        let error = of("\"lobes\"").unwrap_err().to_string();
        assert!(
            error.starts_with("intrinsic.automatic.parts is \"lobes\", but must be a list of sizes, metallic"),
            "{error}"
        );
    }
}

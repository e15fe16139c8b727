//! Settings of the transport stage.

use crate::error::ConfigError;
use serde::{Deserialize, Serialize};

/// Part of the transport stage that an ablation leaves out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TransportPart {
    /// Light that bounces.
    Bounces,
    /// Light from surfaces that no view sees.
    Enclosure,
    /// Light that visible surfaces of emitters send to the camera.
    Emission,
    /// Training of roughness and metallic. All surfaces are matte.
    Specular,
}

/// The transport stage: emitters and bounced light of a room with materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TransportSettings {
    /// Number of surfels at most: 64 to 65536; 0 leaves the stage out of `--stage all`.
    pub surfels: u32,
    /// Rays per surfel, which meet the surfels that light it: 1 to 1024. Not a setting.
    #[serde(skip)]
    pub rays: u32,
    /// Part that is left out. Not a setting.
    #[serde(skip)]
    pub without: Option<TransportPart>,
    /// Number of steps that train materials and lights after the fit of the emitters; 0 leaves materials as they start.
    pub steps: u32,
}

impl TransportSettings {
    /// Minimum of `surfels`.
    pub const LEAST_SURFELS: u32 = 64;
    /// Maximum of `surfels`.
    pub const MOST_SURFELS: u32 = 65_536;
    /// Maximum of `rays`.
    pub const MOST_RAYS: u32 = 1024;

    /// Returns whether `--stage all` trains the stage.
    pub fn enabled(&self) -> bool {
        self.surfels > 0
    }

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// A sentence that names the setting, its value and the allowed values.
    pub fn check(&self) -> crate::Result<()> {
        let (least, most, rays) = (Self::LEAST_SURFELS, Self::MOST_SURFELS, Self::MOST_RAYS);
        if self.enabled() && !(least..=most).contains(&self.surfels) {
            return Err(ConfigError::range("transport.surfels", self.surfels, format!("0 or {least} to {most}")));
        }
        if self.steps == u32::MAX {
            return Err(ConfigError::range("transport.steps", self.steps, "less than 4294967295"));
        }
        if !(1..=rays).contains(&self.rays) {
            return Err(ConfigError::range("transport.rays", self.rays, format!("1 to {rays}")));
        }
        Ok(())
    }
}

impl Default for TransportSettings {
    fn default() -> Self {
        TransportSettings { surfels: 8192, rays: 64, without: None, steps: 500 }
    }
}

#[cfg(test)]
mod tests {
    use super::TransportSettings;
    use crate::Settings;

    #[test]
    fn numbers_outside_of_their_ranges_are_refused() {
        let check = |text: &str| {
            let table = format!("[transport]\n{text}").parse().unwrap();
            Settings::from_table(table).and_then(|s| s.check()).map_err(|e| e.to_string())
        };
        assert_eq!(check("surfels = 64\nsteps = 0"), Ok(()));
        assert_eq!(check("surfels = 0"), Ok(()));
        assert_eq!(check("surfels = 65536\nsteps = 4294967294"), Ok(()));
        let error = check("surfels = 63").unwrap_err();
        assert_eq!(error, "transport.surfels is 63, but must be 0 or 64 to 65536.");
        assert!(check("surfels = 65537").unwrap_err().contains("transport.surfels is 65537"));
        assert!(check("steps = 4294967295").unwrap_err().contains("less than 4294967295"));
        assert!(check("step = 1").unwrap_err().contains("transport.steps"));
        let rays = |rays| TransportSettings { rays, ..TransportSettings::default() }.check().map_err(|e| e.to_string());
        assert_eq!((rays(1), rays(64), rays(1024)), (Ok(()), Ok(()), Ok(())));
        assert_eq!(rays(0).unwrap_err(), "transport.rays is 0, but must be 1 to 1024.");
        assert!(rays(1025).is_err());
        let read = Settings::from_table("[transport]\nsurfels = 64".parse().unwrap()).unwrap();
        assert_eq!(read.transport.rays, 64);
    }
}

//! Settings of the transport stage.

use crate::error::ConfigError;
use serde::{Deserialize, Serialize};

/// The transport stage: emitters and bounced light of a room with materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TransportSettings {
    /// Number of surfels at most: 64 to 65536.
    pub surfels: u32,
    /// Rays per surfel, which meet the surfels that light it: 1 to 1024.
    pub rays: u32,
}

impl TransportSettings {
    /// Minimum of `surfels`.
    pub const LEAST_SURFELS: u32 = 64;
    /// Maximum of `surfels`.
    pub const MOST_SURFELS: u32 = 65_536;
    /// Maximum of `rays`.
    pub const MOST_RAYS: u32 = 1024;

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// A sentence that names the setting, its value and the allowed values.
    pub fn check(&self) -> crate::Result<()> {
        let (least, most, rays) = (Self::LEAST_SURFELS, Self::MOST_SURFELS, Self::MOST_RAYS);
        if !(least..=most).contains(&self.surfels) {
            return Err(ConfigError::range("transport.surfels", self.surfels, format!("{least} to {most}")));
        }
        if !(1..=rays).contains(&self.rays) {
            return Err(ConfigError::range("transport.rays", self.rays, format!("1 to {rays}")));
        }
        Ok(())
    }
}

impl Default for TransportSettings {
    fn default() -> Self {
        TransportSettings { surfels: 8192, rays: 64 }
    }
}

#[cfg(test)]
mod tests {
    use crate::Settings;

    #[test]
    fn numbers_outside_of_their_ranges_are_refused() {
        let check = |text: &str| {
            let table = format!("[transport]\n{text}").parse().unwrap();
            Settings::from_table(table).and_then(|s| s.check()).map_err(|e| e.to_string())
        };
        assert_eq!(check("surfels = 64\nrays = 1"), Ok(()));
        assert_eq!(check("surfels = 65536\nrays = 1024"), Ok(()));
        let error = check("surfels = 63").unwrap_err();
        assert_eq!(error, "transport.surfels is 63, but must be 64 to 65536.");
        assert!(check("surfels = 65537").unwrap_err().contains("transport.surfels is 65537"));
        assert_eq!(check("rays = 0").unwrap_err(), "transport.rays is 0, but must be 1 to 1024.");
        assert!(check("rays = 1025").is_err() && check("ray = 1").unwrap_err().contains("transport.rays"));
    }
}

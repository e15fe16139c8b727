//! Whether the intrinsic stage leaves out what a scene does not require.

use serde::{Deserialize, Serialize};

/// Automatic model selection (docs/how/model.md).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutomaticSettings {
    /// Selects parts by measurement. The other settings are then upper bounds.
    pub enabled: bool,
    /// PSNR gain in dB of the shaded image that keeps a part.
    pub gain: f32,
    /// Measures nothing while shaded images are more than this many dB below those of the Gaussians' own colors.
    pub ready: f32,
    /// Measures lobes, levels and the update interval once shaded images change by at most this many dB between
    /// measurements.
    pub settled: f32,
    /// Chooses sizes of environment map and visibility field from the cameras.
    pub sizes: bool,
    /// Removes metallic by its priors.
    pub metallic: bool,
    /// Removes lights.
    pub lights: bool,
    /// Merges lobes of lights.
    pub lobes: bool,
    /// Removes the environment map.
    pub environment: bool,
    /// Removes visibility.
    pub visibility: bool,
    /// Removes the finest levels of the visibility field.
    pub levels: bool,
    /// Reduces the texels of the environment map.
    pub texels: bool,
    /// Lengthens the update interval of the environment map.
    pub pace: bool,
}

impl Default for AutomaticSettings {
    fn default() -> Self {
        let all = true;
        AutomaticSettings {
            enabled: false,
            gain: 0.02,
            ready: 8.0,
            settled: 0.3,
            sizes: all,
            metallic: all,
            lights: all,
            lobes: all,
            environment: all,
            visibility: all,
            levels: all,
            texels: all,
            pace: all,
        }
    }
}

//! Whether the intrinsic stage leaves out what a scene does not require.

use serde::{Deserialize, Serialize};

/// What may be left out when the scene does not require it; docs/how/model.md says by which measure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutomaticSettings {
    /// Whether anything is. What the settings have is then the most that there may be.
    pub enabled: bool,
    /// What a part must be worth to stay: decibels of the shaded picture at training views.
    pub gain: f32,
    /// Nothing is judged by pictures as long as the shaded ones are more than so many decibels worse than those of the splats' own
    /// colors: what has not been learned yet is worth nothing yet.
    pub ready: f32,
    /// What still learns is not made smaller or slower: lobes, levels of the field and the pace of the surroundings are judged once shaded
    /// pictures change by no more than so many decibels from look to look.
    pub settled: f32,
    /// Sizes of the environment and of the visibility field, by what cameras can tell; false: as set.
    pub sizes: bool,
    /// Metallic, by its priors; false: as intrinsic.metallic says.
    pub metallic: bool,
    /// Lights, one by one; false: all stay.
    pub lights: bool,
    /// Lobes of lights, merged until those that are left are worth it; false: all stay.
    pub lobes: bool,
    /// Surroundings; false: as set.
    pub environment: bool,
    /// Shadows; false: as set.
    pub visibility: bool,
    /// Levels of the visibility field, the finest of which go; false: all stay that its size has.
    pub levels: bool,
    /// Texels of the surroundings, fewer where the finest are worth nothing; false: as many as their size has.
    pub texels: bool,
    /// How often surroundings move, once they are learned; false: as intrinsic.environment.every says.
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

//! Settings of the intrinsic stage, with the defaults of SGS-Intrinsic, stage II.

use super::{AutomaticSettings, OwnPrior};
use crate::error::ConfigError;
use serde::{Deserialize, Serialize};
use sgs_passes::shade::visibility::FieldConfig;

/// The intrinsic stage: materials, lights and shadows on fixed geometry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IntrinsicSettings {
    /// Number of training steps.
    pub steps: u32,
    /// Factor on the size of images in this stage: 0.5 shades a quarter of the pixels.
    pub scale: f64,
    /// Trains a metallic value per Gaussian: `auto` (by its priors), `on` or `off`.
    pub metallic: Metallic,
    /// Lowest and highest albedo in training. Published: 0.09 to 0.99. Files hold 0.01 to 0.99.
    pub albedo_range: [f32; 2],
    /// Initial materials: `priors` or `gray`.
    pub start: MaterialStart,
    /// Point lights.
    pub lights: LightSettings,
    /// Environment map.
    pub environment: EnvironmentSettings,
    /// Visibility of lights.
    pub visibility: VisibilitySettings,
    /// Automatic model selection.
    pub automatic: AutomaticSettings,
    /// Learning rates.
    pub rates: IntrinsicRates,
    /// Weights of the losses.
    pub losses: IntrinsicLosses,
    /// Diffuse radiance that culled lights may lack at a pixel, with white as 1; 0 disables culling.
    pub cull_error: f32,
    /// First step that compares albedo under other lights.
    pub relight_from: u32,
    /// Provider of materials under other lights.
    pub relight: RelightSettings,
    /// Bytes at most for stored blending weights; beyond that each step recomputes them. 0 stores what fits.
    pub surface_bytes: u64,
}

impl Default for IntrinsicSettings {
    fn default() -> Self {
        IntrinsicSettings {
            steps: 3000,
            scale: 1.0,
            metallic: Metallic::Auto,
            albedo_range: [0.01, 0.99],
            start: MaterialStart::Priors,
            lights: LightSettings::default(),
            environment: EnvironmentSettings::default(),
            visibility: VisibilitySettings::default(),
            automatic: AutomaticSettings::default(),
            rates: IntrinsicRates::default(),
            losses: IntrinsicLosses::default(),
            cull_error: 0.0,
            relight_from: 1000,
            relight: RelightSettings::default(),
            surface_bytes: 0,
        }
    }
}

/// Provider of materials under other lights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelightSettings {
    /// Command line of a provider of materials; `own` uses none, and L_relight does not run.
    pub provider: String,
    /// Steps for which an answer is reused. Published: 1.
    pub every: u32,
    /// Weight of the estimated roughness relative to albedo. Published: 0. Not a setting.
    #[serde(skip)]
    pub roughness: f32,
}

impl RelightSettings {
    /// Returns the provider's command line; `None` for `own`.
    pub fn command(&self) -> Option<&str> {
        let command = self.provider.trim();
        (command != "own").then_some(command)
    }
}

impl Default for RelightSettings {
    fn default() -> Self {
        RelightSettings { provider: "own".into(), every: 500, roughness: 0.0 }
    }
}

/// Whether a metallic value is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Metallic {
    /// If metallic priors exist.
    Auto,
    /// Always.
    On,
    /// Never: all materials are dielectric.
    Off,
}

/// Initial materials of splats that have none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaterialStart {
    /// Mean of the priors of all views. The transport stage takes albedo without priors from colors.
    Priors,
    /// Gray with roughness 0.5, as published.
    Gray,
}

/// Point lights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LightSettings {
    /// Initial lights along each axis of the scene's box: 1 to 8; 0 trains no lights.
    pub grid: u32,
    /// Spherical-Gaussian lobes per light: 1 to 32.
    pub lobes: u32,
    /// Initial directions of lobes: `free` or `grid`.
    pub layout: LobeLayout,
    /// Factor on the published initial brightness. The published value depends on the size of the scene's box. Not a setting.
    #[serde(skip)]
    pub start: f32,
}

impl Default for LightSettings {
    fn default() -> Self {
        LightSettings { grid: 4, lobes: 12, layout: LobeLayout::Free, start: 1.0 }
    }
}

impl LightSettings {
    /// Returns whether point lights are trained.
    pub fn enabled(&self) -> bool {
        self.grid > 0
    }
}

/// Initial layout of the lobes of a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LobeLayout {
    /// Two rows around the vertical, each lobe limited to its cell, as published.
    Grid,
    /// Distributed over the sphere, with free directions.
    Free,
}

/// Environment map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnvironmentSettings {
    /// Texels along an edge of the cube: a power of two from 16 to 512; 0 trains no environment map.
    pub resolution: u32,
    /// Initial mean radiance. Published: 1, which closed rooms unlearn slowly.
    pub start: f32,
    /// Steps between updates of texels and mips. An update uses the mean gradient of these steps.
    pub every: u32,
}

impl Default for EnvironmentSettings {
    fn default() -> Self {
        EnvironmentSettings { resolution: 256, start: 0.1, every: 1 }
    }
}

impl EnvironmentSettings {
    /// Returns whether an environment map is trained.
    pub fn enabled(&self) -> bool {
        self.resolution > 0
    }

    /// Returns the texels along an edge of a given environment map.
    ///
    /// The default if none is trained.
    pub fn edge(&self) -> u32 {
        if self.enabled() { self.resolution } else { EnvironmentSettings::default().resolution }
    }
}

/// Visibility of lights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VisibilitySettings {
    /// `field` (learned), `traced` (rays through the Gaussians) or `none`.
    pub kind: VisibilityKind,
    /// Levels of the hash grid.
    pub levels: u32,
    /// Base-2 logarithm of the largest table of a level.
    pub log2_table: u32,
    /// Resolution of the coarsest level.
    pub coarsest: u32,
    /// Resolution of the finest level.
    pub finest: u32,
    /// Supervises one in this many (pixel, light) pairs. Larger is faster and noisier, with the same mean.
    pub sample: u32,
    /// Distance of a ray's start above the surface. The unit is the median over Gaussians of the largest standard
    /// deviation. Not a setting.
    #[serde(skip)]
    pub offset: f32,
    /// Distance of a ray's end before the light, in the unit of `offset`. Keeps the Gaussians of a lamp from occluding
    /// its light. Not a setting.
    #[serde(skip)]
    pub clearance: f32,
}

impl Default for VisibilitySettings {
    fn default() -> Self {
        VisibilitySettings {
            kind: VisibilityKind::Field,
            levels: 16,
            log2_table: 19,
            coarsest: 32,
            finest: 4096,
            sample: 1,
            offset: 2.0,
            clearance: 4.0,
        }
    }
}

impl VisibilitySettings {
    /// Returns the configuration of the visibility field if it is learned.
    pub fn config(&self) -> Option<FieldConfig> {
        let &VisibilitySettings { kind, levels, log2_table, coarsest, finest, .. } = self;
        (kind == VisibilityKind::Field).then_some(FieldConfig::new(levels, log2_table, coarsest, finest))
    }
}

/// Method of computing shadows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VisibilityKind {
    /// Learned: a hash grid and a small network.
    Field,
    /// Ray-traced through the current Gaussians for each pixel and light. Nothing is learned.
    Traced,
    /// No shadows.
    None,
}

/// Learning rates of Adam.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IntrinsicRates {
    /// Rate of albedo, roughness and metallic.
    pub materials: f32,
    /// Rate of lights.
    pub lights: f32,
    /// Rate of the environment map's texels. Not a setting.
    #[serde(skip)]
    pub environment: f32,
    /// Rate of hash tables and network. Not a setting.
    #[serde(skip)]
    pub visibility: f32,
    /// Rate of normals by the light of point lights. Published: 0, which keeps them fixed.
    pub normals: f32,
    /// Factor on the rates of materials and normals at the last step; log-linear from the middle of the stage. Published: 1,
    /// with which albedo follows the noise of the last view.
    pub materials_last: f32,
}

impl Default for IntrinsicRates {
    fn default() -> Self {
        IntrinsicRates {
            materials: 0.01,
            lights: 0.05,
            environment: 0.05,
            visibility: 4e-3,
            normals: 0.0,
            materials_last: 0.05,
        }
    }
}

/// Weights of the losses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IntrinsicLosses {
    /// Mean absolute difference of the shaded image. All other weights are relative to it. Not a setting.
    #[serde(skip)]
    pub l1: f32,
    /// 1 - SSIM of the shaded image, relative to 0.8 for the mean absolute difference.
    pub dssim: f32,
    /// Albedo prior: L1, SSIM and gradients. Published: 0.3.
    pub albedo: f32,
    /// Roughness prior: L1, SSIM and gradients.
    pub roughness: f32,
    /// Metallic prior: L1 and SSIM.
    pub metallic: f32,
    /// Gradients at four scales, within the weights of the priors. Not a setting.
    #[serde(skip)]
    pub gradients: f32,
    /// Edge-aware smoothness of albedo. Published: 1, which removes texture.
    pub albedo_smooth: f32,
    /// Edge-aware smoothness of roughness. Not a setting.
    #[serde(skip)]
    pub roughness_smooth: f32,
    /// Smoothness of the environment map. Not a setting.
    #[serde(skip)]
    pub environment_smooth: f32,
    /// Distance of lights from surfaces. Not a setting.
    #[serde(skip)]
    pub light_position: f32,
    /// Amplitudes of lights. Not a setting.
    #[serde(skip)]
    pub light_value: f32,
    /// Smoothness of visibility under a jitter of points and lights. Not a setting.
    #[serde(skip)]
    pub visibility_jitter: f32,
    /// L_cross_semantic: albedo of a region between views.
    pub cross_view: f32,
    /// L_relight: albedo of a region against a provider's estimates under perturbed lights. Needs `relight.provider`.
    pub relight: f32,
    /// Albedo of a region against the view's own prior, in the steps of `relight`; not in the paper. "auto": the weight of
    /// `relight` without a provider, else 0.
    pub own_prior: OwnPrior,
}

impl Default for IntrinsicLosses {
    fn default() -> Self {
        IntrinsicLosses {
            l1: 0.8,
            dssim: 0.2,
            albedo: 1.0,
            roughness: 0.3,
            metallic: 0.3,
            gradients: 1.0,
            albedo_smooth: 0.1,
            roughness_smooth: 0.2,
            environment_smooth: 0.01,
            light_position: 1e-6,
            light_value: 1e-4,
            visibility_jitter: 0.4,
            cross_view: 0.4,
            relight: 0.4,
            own_prior: OwnPrior::Auto,
        }
    }
}

impl IntrinsicSettings {
    /// Returns the weight of L_relight; 0 without a provider of materials.
    pub fn relight_weight(&self) -> f32 {
        if self.relight.command().is_some() { self.losses.relight } else { 0.0 }
    }

    /// Returns the weight of the loss of albedo against the view's own prior.
    pub fn own_prior_weight(&self) -> f32 {
        match self.losses.own_prior {
            OwnPrior::Weight(weight) => weight,
            OwnPrior::Auto if self.relight.command().is_none() => self.losses.relight,
            OwnPrior::Auto => 0.0,
        }
    }

    /// Checks values that the types do not constrain.
    pub(super) fn check(&self, table: &toml::Table) -> crate::Result<()> {
        if let Some((name, value)) = wrong_number("intrinsic", table) {
            return Err(ConfigError::range(name, value, "a finite number of at least 0"));
        }
        let [low, high] = self.albedo_range;
        if !(low >= 0.01 && high <= 0.99 && low < high) {
            let value = format_args!("[{low}, {high}]");
            return Err(ConfigError::range("intrinsic.albedo_range", value, "two growing numbers from 0.01 to 0.99"));
        }
        let (e, v, l) = (&self.environment, &self.visibility, &self.lights);
        if e.enabled() && !(e.resolution.is_power_of_two() && (16..=512).contains(&e.resolution)) {
            return Err(ConfigError::range(
                "intrinsic.environment.resolution",
                e.resolution,
                "0, 16, 32, 64, 128, 256 or 512",
            ));
        }
        if !(0.05..=1.0).contains(&self.scale) {
            return Err(ConfigError::range("intrinsic.scale", self.scale, "0.05 to 1"));
        }
        if !(1..=64).contains(&e.every) {
            return Err(ConfigError::range("intrinsic.environment.every", e.every, "1 to 64"));
        }
        if l.grid > 8 {
            return Err(ConfigError::range("intrinsic.lights.grid", l.grid, "0 to 8"));
        }
        if !(1..=32).contains(&l.lobes) {
            return Err(ConfigError::range("intrinsic.lights.lobes", l.lobes, "1 to 32"));
        }
        if !(1..=4096).contains(&v.sample) {
            return Err(ConfigError::range("intrinsic.visibility.sample", v.sample, "1 to 4096"));
        }
        if let Some(Err(e)) = v.config().map(|c| c.check()) {
            return Err(ConfigError::Combination(format!("intrinsic.visibility cannot be: {e}")));
        }
        let r = &self.relight;
        if r.provider.trim().is_empty() {
            return Err(ConfigError::range("intrinsic.relight.provider", "empty", "\"own\" or a command line"));
        }
        if r.every == 0 {
            return Err(ConfigError::range("intrinsic.relight.every", "0", "at least 1"));
        }
        if r.command().is_some() && !l.enabled() && self.losses.relight > 0.0 {
            let what = "intrinsic.relight.provider is to see other lights, but intrinsic.lights.grid is 0.";
            return Err(ConfigError::Combination(what.into()));
        }
        let [ready, settled] = self.automatic.limits;
        if [ready, settled].iter().any(|v| !(*v >= 0.0 && v.is_finite())) {
            let value = format_args!("[{ready}, {settled}]");
            return Err(ConfigError::range("intrinsic.automatic.limits", value, "two finite numbers of at least 0"));
        }
        Ok(())
    }
}

/// Returns name and value of the first number that is negative or not finite.
fn wrong_number(prefix: &str, table: &toml::Table) -> Option<(String, String)> {
    table.iter().find_map(|(key, value)| {
        let name = format!("{prefix}.{key}");
        match value {
            toml::Value::Table(inner) => wrong_number(&name, inner),
            toml::Value::Float(f) if !(f.is_finite() && *f >= 0.0) => Some((name, f.to_string())),
            _ => None,
        }
    })
}

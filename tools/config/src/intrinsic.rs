//! Settings of the intrinsic stage, with the defaults of SGS-Intrinsic, stage II.

use super::{AutomaticSettings, OwnPrior};
use crate::error::ConfigError;
use serde::{Deserialize, Serialize};
use sgs_passes::shade::visibility::FieldConfig;

/// The intrinsic stage: materials, lights and shadows on fixed geometry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IntrinsicSettings {
    /// Training steps.
    pub steps: u32,
    /// Share of the pictures' width and height that materials and lights are learned at: 0.5 shades a quarter of the pixels.
    pub scale: f64,
    /// Whether there is a metallic value for each Gaussian.
    pub metallic: Metallic,
    /// Lowest and highest albedo that training may reach. Files hold 0.01 to 0.99. Published: 0.09 to 0.99.
    pub albedo_range: [f32; 2],
    /// Where materials begin.
    pub start: MaterialStart,
    /// Point lights.
    pub lights: LightSettings,
    /// The light of the surroundings.
    pub environment: EnvironmentSettings,
    /// What lights see.
    pub visibility: VisibilitySettings,
    /// Whether what the scene does not require is left out.
    pub automatic: AutomaticSettings,
    /// Learning rates.
    pub rates: IntrinsicRates,
    /// Weights of the losses.
    pub losses: IntrinsicLosses,
    /// What diffuse light of lamps may be short of, in units of the picture's white: lights too faint to matter to a block of pixels
    /// are left out there. 0 leaves none out.
    pub cull_error: f32,
    /// Pixels that are too bright for the picture keep the gradients that lead them back.
    pub returning: bool,
    /// Of how many steps one compares albedo with pseudo-views, and the next one under other lights.
    pub consistency_interval: u32,
    /// The first step that compares albedo with pseudo-views.
    pub cross_view_from: u32,
    /// The first step that compares albedo under other lights.
    pub relight_from: u32,
    /// Who estimates albedo under other lights.
    pub relight: RelightSettings,
    /// Most bytes for what views see of the geometry; beyond that it is worked out anew in each step. 0 for what fits.
    pub surface_bytes: u64,
    /// Steps between checkpoints; 0 keeps only the last.
    pub checkpoint_interval: u32,
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
            returning: false,
            consistency_interval: 3,
            cross_view_from: 1,
            relight_from: 1000,
            relight: RelightSettings::default(),
            surface_bytes: 0,
            checkpoint_interval: 500,
        }
    }
}

/// Who estimates materials under other lights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelightSettings {
    /// Command line of a provider of materials, which is shown the view under perturbed lights. `own`: none is asked, and
    /// L_relight does not run.
    pub provider: String,
    /// What it has said of a view serves for so many steps. 1 asks each time, as published.
    pub every: u32,
    /// Copies of the lights, each perturbed in its own way: 1 or 2.
    pub copies: u32,
    /// What its roughness weighs beside its albedo. Published: 0, which asks for albedo alone.
    pub roughness: f32,
}

impl RelightSettings {
    /// The provider's command line, if there is to be one.
    pub fn command(&self) -> Option<&str> {
        let command = self.provider.trim();
        (command != "own").then_some(command)
    }
}

impl Default for RelightSettings {
    fn default() -> Self {
        RelightSettings { provider: "own".into(), every: 500, copies: 2, roughness: 0.0 }
    }
}

/// Whether metals are told from other materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Metallic {
    /// Where there are priors of it.
    Auto,
    /// Always.
    On,
    /// Never: everything is a dielectric.
    Off,
}

/// Where materials begin that the splats do not bring.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaterialStart {
    /// With the mean of what the priors of all views say.
    Priors,
    /// Gray and half rough, as published.
    Gray,
}

/// Point lights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LightSettings {
    /// Whether there are any.
    pub enabled: bool,
    /// Lights along each axis of the scene's box at first.
    pub grid: u32,
    /// Lobes of a light: 1 to 32.
    pub lobes: u32,
    /// How lobes are laid out.
    pub layout: LobeLayout,
    /// Lights that come to less than this share of the brightest one's largest amplitude are switched off; 0 keeps all.
    pub prune: f32,
    /// Factor on the brightness that they begin with, which is the published one for the size of the scene's box.
    pub start: f32,
}

impl Default for LightSettings {
    fn default() -> Self {
        LightSettings { enabled: true, grid: 4, lobes: 12, layout: LobeLayout::Free, prune: 0.0, start: 1.0 }
    }
}

/// How the twelve lobes of a light are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LobeLayout {
    /// Two rows of six around the vertical, each in its cell, as published.
    Grid,
    /// Spread over the sphere, free to turn anywhere.
    Free,
}

/// The light of the surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnvironmentSettings {
    /// Whether there is any.
    pub enabled: bool,
    /// Texels along an edge of the cube: 16 to 512, a power of two.
    pub resolution: u32,
    /// Mean of its texels at first. The published start is 1, which in closed rooms takes long to go away: pictures of the White
    /// Room are 2 to 3 dB better from 0.1 (docs/project/ablation.md).
    pub start: f32,
    /// Its texels move after one of so many steps, as far, by what all of these asked of them; its mips are filtered then and not in
    /// between.
    pub every: u32,
}

impl Default for EnvironmentSettings {
    fn default() -> Self {
        EnvironmentSettings { enabled: true, resolution: 256, start: 0.1, every: 1 }
    }
}

/// What lights see.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VisibilitySettings {
    /// How it is found.
    pub kind: VisibilityKind,
    /// Levels of the hash grid.
    pub levels: u32,
    /// Logarithm to base 2 of the largest table of a level.
    pub log2_table: u32,
    /// Resolution of the coarsest level.
    pub coarsest: u32,
    /// Resolution of the finest level.
    pub finest: u32,
    /// One pair of pixel and light of so many teaches the field in a step, for as many: 1 is all of them. More is quicker and
    /// noisier, and right in the mean.
    pub sample: u32,
    /// How far above surfaces traced rays begin, in units of the middle one of the Gaussians' largest standard deviations.
    pub offset: f32,
    /// How far before a light they end, in the same unit: what it is fixed in does not hide it.
    pub clearance: f32,
    /// Standard deviation of the jitter that visibility should not notice, as a share of half the scene's box.
    pub jitter: f32,
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
            jitter: 0.01 / 1.5,
        }
    }
}

impl VisibilitySettings {
    /// The field, if it is learned.
    pub fn config(&self) -> Option<FieldConfig> {
        let &VisibilitySettings { kind, levels, log2_table, coarsest, finest, .. } = self;
        (kind == VisibilityKind::Field).then_some(FieldConfig::new(levels, log2_table, coarsest, finest))
    }
}

/// How shadows are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VisibilityKind {
    /// Learned: a hash grid and a small network.
    Field,
    /// Nothing is learned: rays go through the Gaussians as they are, for each pixel and light.
    Traced,
    /// Nothing is in the way of any light.
    None,
}

/// Learning rates of Adam.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IntrinsicRates {
    /// Of albedo.
    pub albedo: f32,
    /// Of roughness.
    pub roughness: f32,
    /// Of metallic.
    pub metallic: f32,
    /// Of lights.
    pub lights: f32,
    /// Of the environment's texels.
    pub environment: f32,
    /// Of hash tables and network.
    pub visibility: f32,
    /// Of normals, through what lamps shade; 0, as published, leaves them as they came.
    pub normals: f32,
    /// What is left of those of materials and normals at the last step; they fall from the middle of the stage on, evenly in their
    /// logarithm. Published: 1. Albedo then follows the noise of the view that it saw last.
    pub materials_last: f32,
}

impl Default for IntrinsicRates {
    fn default() -> Self {
        IntrinsicRates {
            albedo: 0.01,
            roughness: 0.01,
            metallic: 0.01,
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
    /// Mean absolute difference of the shaded picture.
    pub l1: f32,
    /// One minus its SSIM.
    pub dssim: f32,
    /// Of the albedo prior: times the same two and the gradients. Published: 0.3, which leaves more of albedo to what lights
    /// cannot explain.
    pub albedo: f32,
    /// Of the roughness prior, likewise.
    pub roughness: f32,
    /// Of the metallic prior, likewise but without gradients.
    pub metallic: f32,
    /// Differences of gradients at four scales, within the weights of the priors.
    pub gradients: f32,
    /// Edge-aware smoothness of albedo. Published: 1, which wipes out what is painted on a floor.
    pub albedo_smooth: f32,
    /// The same of roughness.
    pub roughness_smooth: f32,
    /// Smoothness of the environment.
    pub environment_smooth: f32,
    /// Nearness of lights to surfaces.
    pub light_position: f32,
    /// Amplitudes of lights.
    pub light_value: f32,
    /// How much visibility notices a jitter of places.
    pub visibility_jitter: f32,
    /// Albedo of a region in other views.
    pub cross_view: f32,
    /// L_relight: albedo of a region against what a provider of materials estimates under perturbed lights. Needs
    /// `relight.provider`.
    pub relight: f32,
    /// Albedo of a region against the view's own prior, in the steps of `relight`; not in the paper. "auto": the weight of
    /// `relight` where no provider is asked, else 0.
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
    /// The weight of L_relight, 0 where no provider of materials is asked.
    pub fn relight_weight(&self) -> f32 {
        if self.relight.command().is_some() { self.losses.relight } else { 0.0 }
    }

    /// The weight of comparing albedo with the view's own prior.
    pub fn own_prior_weight(&self) -> f32 {
        match self.losses.own_prior {
            OwnPrior::Weight(weight) => weight,
            OwnPrior::Auto if self.relight.command().is_none() => self.losses.relight,
            OwnPrior::Auto => 0.0,
        }
    }

    /// Checks what types cannot.
    pub(super) fn check(&self, table: &toml::Table) -> crate::Result<()> {
        if let Some((name, value)) = wrong_number("intrinsic", table) {
            let what = format!("{name} is {value}, but must be a finite number of at least 0.");
            return Err(ConfigError::new(what));
        }
        let [low, high] = self.albedo_range;
        if !(low >= 0.01 && high <= 0.99 && low < high) {
            return Err(ConfigError::new(format!(
                "intrinsic.albedo_range is [{low}, {high}], but must be two growing numbers from 0.01 to 0.99."
            )));
        }
        let (e, v, l) = (&self.environment, &self.visibility, &self.lights);
        let fail = |what: String| Err(ConfigError::new(what));
        if !(e.resolution.is_power_of_two() && (16..=512).contains(&e.resolution)) {
            return fail(format!(
                "intrinsic.environment.resolution is {}, but must be 16, 32, 64, 128, 256 or 512.",
                e.resolution
            ));
        }
        if !(0.05..=1.0).contains(&self.scale) {
            return fail(format!("intrinsic.scale is {}, but must be 0.05 to 1.", self.scale));
        }
        if !(1..=64).contains(&e.every) {
            return fail(format!("intrinsic.environment.every is {}, but must be 1 to 64.", e.every));
        }
        if !(1..=8).contains(&l.grid) {
            return fail(format!("intrinsic.lights.grid is {}, but must be 1 to 8.", l.grid));
        }
        if !(1..=32).contains(&l.lobes) {
            return fail(format!("intrinsic.lights.lobes is {}, but must be 1 to 32.", l.lobes));
        }
        if !(1..=4096).contains(&v.sample) {
            return fail(format!("intrinsic.visibility.sample is {}, but must be 1 to 4096.", v.sample));
        }
        if let Some(Err(e)) = v.config().map(|c| c.check()) {
            return fail(format!("intrinsic.visibility cannot be: {e}"));
        }
        let r = &self.relight;
        if r.provider.trim().is_empty() {
            return fail("intrinsic.relight.provider is empty, but must be \"own\" or a command line.".into());
        }
        if r.every == 0 {
            return fail("intrinsic.relight.every is 0, but must be at least 1.".into());
        }
        if !(1..=2).contains(&r.copies) {
            return fail(format!("intrinsic.relight.copies is {}, but must be 1 or 2.", r.copies));
        }
        if r.command().is_some() && !self.lights.enabled && self.losses.relight > 0.0 {
            return fail(
                "intrinsic.relight.provider is to see other lights, but intrinsic.lights.enabled is false.".into(),
            );
        }
        if self.consistency_interval < 3 {
            return fail(format!(
                "intrinsic.consistency_interval is {}, but must be at least 3.",
                self.consistency_interval
            ));
        }
        Ok(())
    }
}

/// The first number below zero, or none at all.
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

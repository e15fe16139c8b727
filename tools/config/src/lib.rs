//! Settings with their defaults and descriptions. `config.toml` of a run contains all of them, resolved.

mod accuracy;
mod automatic;
mod degree;
mod densify;
mod error;
mod intrinsic;
mod memory;
mod names;
mod noise;
mod own_prior;
mod presets;
mod provider;
mod pseudo;
mod rates;
mod train;
mod transport;
mod view_rates;

pub use accuracy::{ACCURACY_LEVELS, accuracy_named};
pub use automatic::{AutomaticSettings, Parts};
pub use degree::{MOST_BANDS, ShDegree};
pub use densify::{DensifyOptions, DensifyRule};
pub use error::{ConfigError, Result};
pub use intrinsic::{
    EnvironmentSettings, IntrinsicLosses, IntrinsicRates, IntrinsicSettings, LightSettings, LobeLayout, MaterialStart,
    Metallic, RelightSettings, VisibilityKind, VisibilitySettings,
};
pub use memory::{MemorySettings, parse_bytes};
pub use names::{end_mark, one_line};
pub use noise::NoiseSettings;
pub use own_prior::OwnPrior;
pub use presets::{PRESETS, Preset, overlay};
pub use provider::ProviderSettings;
pub use pseudo::{Neighbors, Position, PseudoOptions};
pub use rates::Rates;
pub use train::{OnDivergence, TrainSettings};
pub use transport::{TransportPart, TransportSettings};
pub use view_rates::ViewRates;

use serde::{Deserialize, Serialize};
use sgs_passes::Accuracy;
use sgs_scene::{MaskUse, SplitRule};
use std::path::PathBuf;

/// All settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Scene directory.
    pub scene: PathBuf,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Training and test views: "auto", "every:N", "linspace:N", or a file like split.json.
    pub split: SplitRule,
    /// Number of training views, spread evenly; 0 uses all.
    pub views: usize,
    /// Factor on the size of images, at most 1.
    pub scale: f64,
    /// Factor on linear images; 0 chooses it from the training views.
    pub exposure: f32,
    /// Leaves invalid pixels of the data set out of losses and measures. They are black in masks; with "inverted" white.
    pub masks: MaskUse,
    /// Number of random points for a scene without points.
    pub random_points: usize,
    /// Device memory.
    pub memory: MemorySettings,
    /// Accuracy traded for speed.
    pub accuracy: Accuracy,
    /// Noise on the inputs of training.
    pub noise: NoiseSettings,
    /// Provider of region masks during training.
    pub provider: ProviderSettings,
    /// Settings of all stages.
    pub train: TrainSettings,
    /// The geometry stage.
    pub geometry: GeometrySettings,
    /// The intrinsic stage.
    pub intrinsic: IntrinsicSettings,
    /// The transport stage.
    pub transport: TransportSettings,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            scene: PathBuf::new(),
            seed: 0,
            split: SplitRule::Auto,
            views: 0,
            scale: 1.0,
            exposure: 0.0,
            masks: MaskUse::Valid,
            random_points: 20_000,
            memory: MemorySettings::default(),
            accuracy: Accuracy::default(),
            noise: NoiseSettings::default(),
            provider: ProviderSettings::default(),
            train: TrainSettings::default(),
            geometry: GeometrySettings::default(),
            intrinsic: IntrinsicSettings::default(),
            transport: TransportSettings::default(),
        }
    }
}

/// The geometry stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometrySettings {
    /// Number of training steps.
    pub steps: u32,
    /// Highest band of spherical harmonics: 0 to 3, or "auto" to measure which bands gain 0.02 dB at held-back
    /// training views.
    pub sh_degree: ShDegree,
    /// PSNR gain in dB that keeps a band with "auto", at held-back training views. Not a setting.
    #[serde(skip)]
    pub sh_gain: f64,
    /// Fraction of the steps with smaller photographs: first a quarter of the width and height, then half. 0 uses full
    /// size.
    pub coarse: f64,
    /// Background color, display-referred.
    pub background: [f32; 3],
    /// Filter of projected Gaussians: `dilated` (3DGS) or `mip`, which scales opacities so that dilation adds no light. Files record it.
    pub filter: Filter,
    /// Uses normal priors.
    pub normals: bool,
    /// Uses semantic priors.
    pub semantics: bool,
    /// Lets semantic losses move opacities, positions and shapes.
    pub semantic_geometry: bool,
    /// Temperature of the softmax over class cosines. Not a setting.
    #[serde(skip)]
    pub temperature: f32,
    /// First step that compares regions with pseudo-views.
    pub correspondence_from: u32,
    /// Poses of pseudo-views.
    pub pseudo: PseudoOptions,
    /// Learning rates.
    pub rates: Rates,
    /// Adam also moves Gaussians that a step did not see, as in 3DGS. Slower; results differ slightly.
    pub dense_adam: bool,
    /// Weights of the losses.
    pub losses: LossWeights,
    /// Densification.
    pub densify: DensifyOptions,
    /// Kernel of the gradients of blending: `auto`, `pixel`, `splat`, `bucket`, or `atomic`, which is not deterministic.
    pub backward: Backward,
    /// Initial capacity of tile entries; 0 estimates it. The capacity grows as needed, with the same results. Not a
    /// setting.
    #[serde(skip)]
    pub entry_capacity: u32,
}

impl Default for GeometrySettings {
    fn default() -> Self {
        GeometrySettings {
            steps: 7000,
            sh_degree: ShDegree::Fixed(3),
            sh_gain: 0.02,
            coarse: 0.5,
            background: [0.0; 3],
            filter: Filter::Dilated,
            normals: true,
            semantics: true,
            semantic_geometry: true,
            temperature: 1.0,
            correspondence_from: 2000,
            pseudo: PseudoOptions::default(),
            rates: Rates::default(),
            dense_adam: false,
            losses: LossWeights::default(),
            densify: DensifyOptions::default(),
            backward: Backward::Auto,
            entry_capacity: 0,
        }
    }
}

/// Filter of projected Gaussians against aliasing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// Adds 0.3 px² to the projected covariance (Kerbl et al. 2023).
    Dilated,
    /// Scales opacities, too: the 2D Mip filter (Yu et al. 2024).
    Mip,
}

/// Backward kernel of blending. All give the same gradients up to rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backward {
    /// Selected by measurement after a few steps. The run's settings record the result.
    Auto,
    /// Lanes are pixels.
    Pixel,
    /// Lanes are splats.
    Splat,
    /// Lanes are splats of a bucket of a tile's entries; small views fill a GPU. Needs memory for checkpoints.
    Bucket,
    /// Lanes are pixels; sums over tiles use atomics. Needs less memory, but results vary from run to run.
    Atomic,
}

/// Weights of the losses (SGS-Intrinsic, stage I).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Mean absolute difference. All other weights are relative to it. Not a setting.
    #[serde(skip)]
    pub l1: f32,
    /// 1 - SSIM, relative to 0.8 for the mean absolute difference.
    pub dssim: f32,
    /// 1 - cosine to the normal prior.
    pub normal: f32,
    /// Edge-aware smoothness of normals.
    pub normal_smooth: f32,
    /// Relative difference from prior depths, those of a sensor or of `priors/depth`.
    pub depth: f32,
    /// Edge-aware smoothness of depth; it needs no priors.
    pub depth_smooth: f32,
    /// Depth variance along a ray at step 0; grows tenfold every 5000 steps until step 7000. It needs no priors.
    pub depth_variance: f32,
    /// 1 - cosine of decoded features to the semantic prior. Published: 1, which harms geometry.
    pub semantic: f32,
    /// Cross-entropy of the class to that of the prior. Published: 1.
    pub semantic_class: f32,
    /// Difference of a region's features and classes between views. Needs semantic priors. Published: 0.3.
    pub correspondence: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        LossWeights {
            l1: 0.8,
            dssim: 0.2,
            normal: 0.05,
            normal_smooth: 0.01,
            depth: 0.2,
            depth_smooth: 0.01,
            depth_variance: 0.02,
            semantic: 0.02,
            semantic_class: 0.02,
            correspondence: 0.006,
        }
    }
}

impl GeometrySettings {
    /// Returns whether a depth term has a weight.
    pub fn depth_terms(&self) -> bool {
        self.losses.depth_smooth > 0.0 || self.losses.depth_variance > 0.0
    }

    /// Returns the factor on the learning rates.
    ///
    /// By default it grows for runs shorter than the 7000 steps for which the rates are tuned, up to 3.
    pub fn rate_factor(&self) -> f64 {
        if self.rates.factor > 0.0 {
            return self.rates.factor;
        }
        (7000.0 / f64::from(self.steps.max(1))).sqrt().clamp(1.0, 3.0)
    }
}

impl Settings {
    /// Returns the options with which these settings open the scene.
    pub fn scene_options(&self) -> sgs_scene::SceneOptions {
        sgs_scene::SceneOptions {
            split: self.split.clone(),
            views: (self.views > 0).then_some(self.views),
            scale: self.scale,
            exposure: (self.exposure != 0.0).then_some(self.exposure),
            background: self.geometry.background,
            masks: self.masks,
            random_points: self.random_points,
            seed: self.seed,
        }
    }

    /// Parses settings from a table. Absent settings have their defaults.
    ///
    /// # Errors
    /// A sentence that names the setting that does not exist, or whose value is of another kind.
    pub fn from_table(table: toml::Table) -> crate::Result<Settings> {
        let known = Settings::default().to_table()?;
        names::compare("", &table, &known, &known)?;
        let wrong = |e: toml::de::Error| match names::word(&table, |t| t.try_into::<Settings>().err()) {
            Some(error) => error,
            None => ConfigError::Format(format!("A setting is wrong: {}.", one_line(e.message()))),
        };
        toml::Value::Table(table.clone()).try_into().map_err(wrong)
    }

    /// Returns all settings as a table.
    ///
    /// # Errors
    /// If a value cannot be written as TOML.
    pub fn to_table(&self) -> crate::Result<toml::Table> {
        toml::Table::try_from(self).map_err(|e| ConfigError::Format(format!("The settings cannot be written: {e}.")))
    }

    /// Checks values that the types do not constrain.
    ///
    /// # Errors
    /// A sentence that names the setting, its value and the allowed values.
    pub fn check(&self) -> crate::Result<()> {
        let g = &self.geometry;
        if i64::try_from(self.seed).is_err() {
            let allowed = format!("at most {}, the largest number of TOML", i64::MAX);
            return Err(ConfigError::range("seed", self.seed, allowed));
        }
        if i64::try_from(self.memory.budget).is_err() {
            return Err(ConfigError::range("memory.budget", self.memory.budget, format!("at most {}", i64::MAX)));
        }
        accuracy::check(&self.accuracy)?;
        self.train.check()?;
        self.transport.check()?;
        self.provider.check()?;
        self.noise.check()?;
        if g.sh_degree.most() > MOST_BANDS {
            return Err(ConfigError::range("geometry.sh_degree", g.sh_degree, "0 to 3 or \"auto\""));
        }
        if !(self.scale > 0.0 && self.scale <= 1.0) {
            return Err(ConfigError::range("scale", self.scale, "above 0 and at most 1"));
        }
        if !(0.0..=1.0).contains(&g.coarse) {
            return Err(ConfigError::range("geometry.coarse", g.coarse, "0 to 1"));
        }
        if g.background.iter().any(|v| !v.is_finite()) {
            let value = format_args!("{:?}", g.background);
            return Err(ConfigError::range("geometry.background", value, "three finite numbers"));
        }
        let (r, l, d) = (&g.rates, &g.losses, &g.densify);
        let views = r.views.fixed().unwrap_or_default();
        for (name, value) in [
            ("rates.means", r.means[0]),
            ("rates.means", r.means[1]),
            ("rates.views", views[0]),
            ("rates.views", views[1]),
            ("rates.views", views[2]),
            ("rates.views", views[3]),
            ("losses.dssim", f64::from(l.dssim)),
            ("losses.normal", f64::from(l.normal)),
            ("losses.normal_smooth", f64::from(l.normal_smooth)),
            ("losses.depth_smooth", f64::from(l.depth_smooth)),
            ("losses.depth_variance", f64::from(l.depth_variance)),
            ("losses.depth", f64::from(l.depth)),
            ("losses.semantic", f64::from(l.semantic)),
            ("losses.semantic_class", f64::from(l.semantic_class)),
            ("losses.correspondence", f64::from(l.correspondence)),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                let setting = format_args!("geometry.{name}");
                return Err(ConfigError::range(setting, value, "a finite number of at least 0"));
            }
        }
        d.check()?;
        let table = toml::Table::try_from(&self.intrinsic).unwrap_or_default();
        self.intrinsic.check(&table)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fail(text: &str) -> String {
        Settings::from_table(text.parse().unwrap()).and_then(|s| s.check()).unwrap_err().to_string()
    }

    #[test]
    fn all_settings_round_trip() {
        let mut s = Settings { seed: 7, ..Settings::default() };
        s.geometry.rates.means = [0.1, 0.01];
        s.geometry.background = [0.1, 0.2, 0.3];
        assert_eq!(Settings::from_table(s.to_table().unwrap()).unwrap(), s);
        assert_eq!(Settings::from_table(toml::Table::new()).unwrap(), Settings::default());
    }

    #[test]
    fn each_fault_has_its_own_message() {
        assert_eq!(
            fail("[geometry]\nstep = 1"),
            "\"geometry.step\" is not a setting; did you mean \"geometry.steps\"?"
        );
        assert_eq!(
            fail("[intrinsic.visibility]\nkind = \"trace\"\nlevels = 3"),
            "\"intrinsic.visibility.kind\" is \"trace\", but must be one of \"field\", \"traced\", \"none\"; did you mean \"traced\"?"
        );
        assert_eq!(
            fail("[geometry.pseudo]\nneighbors = \"everything\""),
            "\"geometry.pseudo.neighbors\" is \"everything\", but must be one of \"training\", \"test\"."
        );
        assert_eq!(
            fail("[intrinsic.lights]\nenabled = false"),
            "\"intrinsic.lights.enabled\" is not a setting; did you mean \"intrinsic.lights.grid\"?"
        );
        assert_eq!(
            fail("[geometry.pseudo]\nposes = 3"),
            "\"geometry.pseudo.poses\" is not a setting; there are geometry.pseudo.neighbors, geometry.pseudo.position."
        );
        assert!(fail("[geometry]\ndepth_smooth = false").contains("did you mean \"geometry.losses.depth_smooth\"?"));
        assert!(fail("[noise]\ncameras = [200, 0]").ends_with("but must be two numbers, 0 to 180 and 0 to 100."));
        assert!(fail("[provider]\nseconds = [1, 0]").ends_with("but must be two finite numbers above 0."));
        assert!(fail("[intrinsic.automatic]\nlimits = [-1, 0]").ends_with("two finite numbers of at least 0."));
        assert!(fail("steps = 1").contains("did you mean \"geometry.steps\"?"));
        assert!(fail("[geometry.rates]\nviews = [0, 0, 0, -1]").contains("geometry.rates.views"));
        assert!(fail("[geometry.rates]\nmeans_final = 1e-6").contains("did you mean \"geometry.rates.means\"?"));
        assert!(fail("[geometry.densify]\nstatistic = \"total\"").contains("did you mean \"geometry.densify.rule\"?"));
        assert!(fail("[geometry.rates]\nzebra = 1").contains("there are geometry.rates.factor, geometry.rates.means"));
        assert_eq!(fail("[geometry]\nsteps = \"many\""), "geometry.steps is \"many\", but must be a whole number.");
        assert_eq!(fail("[geometry]\nsteps = 4.5"), "geometry.steps is 4.5, but must be a whole number.");
        assert_eq!(fail("[geometry]\nsteps = -4"), "geometry.steps is -4, but must be at least 0.");
        assert_eq!(fail("geometry = 3"), "geometry is 3, but must be a group of settings.");
        assert!(fail("[geometry]\nbackground = [1, 2]").ends_with("but must be 3 numbers."));
        assert!(fail("[geometry]\nbackground = [1, 2, nan]").contains("three finite numbers"));
        assert!(fail("[geometry]\nnormals = 1").ends_with("but must be true or false."));
        assert!(fail("[geometry.losses]\ndssim = nan").contains("geometry.losses.dssim is NaN"));
        assert!(fail("[geometry.losses]\ndssim = 1e300").contains("geometry.losses.dssim is inf"));
        assert!(fail("[geometry.densify]\nuntil = 2").contains("geometry.densify.until is 2"));
    }

    #[test]
    fn kinds_of_faults_are_distinct() {
        let error =
            |text: &str| Settings::from_table(text.parse().unwrap()).and_then(|s| s.check().map(|()| s)).unwrap_err();
        use ConfigError::{Combination, OutOfRange, UnknownItem, UnknownName, UnknownSetting, UnknownWord, WrongType};
        let near = |name: &Option<String>, expected: &str| name.as_deref() == Some(expected);
        assert!(matches!(error("seeds = 1"), UnknownSetting { nearest, .. } if near(&nearest, "seed")));
        assert!(matches!(error("seed = true"), WrongType { setting, .. } if setting == "seed"));
        assert!(matches!(
            error("scale = 2.0"),
            OutOfRange { setting, value, allowed } if [&setting, &value, &allowed] == ["scale", "2", "above 0 and at most 1"]
        ));
        let word = error("[intrinsic]\nmetallic = \"of\"");
        assert!(matches!(word, UnknownWord { nearest, known, .. } if near(&nearest, "off") && known.len() == 3));
        assert!(
            matches!(error("[intrinsic.automatic]\nparts = [\"lobe\"]"), UnknownItem { known, .. } if known.len() == 9)
        );
        let other = "[intrinsic]\nrelight = { provider = \"ask\" }\nlights = { grid = 0 }";
        assert!(matches!(error(other), Combination(_)));
        assert!(matches!(Preset::find("papr"), Err(UnknownName { nearest, .. }) if near(&nearest, "paper")));
        assert!(matches!(accuracy_named("exat"), Err(UnknownName { nearest, .. }) if near(&nearest, "exact")));
    }
}

//! Every setting, with its default and what it does. `config.toml` of a run holds them all, resolved.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// All settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// The scene directory.
    pub scene: PathBuf,
    /// Seed of everything random.
    pub seed: u64,
    /// How many training views, spread evenly; 0 for all.
    pub views: usize,
    /// Factor on the images' size.
    pub scale: f64,
    /// Exposure of linear images.
    pub exposure: f32,
    /// Random points where the scene has none.
    pub random_points: usize,
    /// The geometry stage.
    pub geometry: GeometrySettings,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            scene: PathBuf::new(),
            seed: 0,
            views: 0,
            scale: 1.0,
            exposure: 1.0,
            random_points: 20_000,
            geometry: GeometrySettings::default(),
        }
    }
}

/// The geometry stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometrySettings {
    /// Training steps.
    pub steps: u32,
    /// Highest band of spherical harmonics.
    pub sh_degree: u32,
    /// Steps after which the next band is switched on; 0 switches all on at once.
    pub sh_interval: u32,
    /// Color behind everything.
    pub background: [f32; 3],
    /// Whether priors of normals are used where there are any.
    pub normals: bool,
    /// Learning rates.
    pub rates: Rates,
    /// Weights of the losses.
    pub losses: LossWeights,
    /// Densification.
    pub densify: DensifyOptions,
    /// Steps between checkpoints; 0 keeps only the last.
    pub checkpoint_interval: u32,
}

impl Default for GeometrySettings {
    fn default() -> Self {
        GeometrySettings {
            steps: 7000,
            sh_degree: 3,
            sh_interval: 1000,
            background: [0.0; 3],
            normals: true,
            rates: Rates::default(),
            losses: LossWeights::default(),
            densify: DensifyOptions::default(),
            checkpoint_interval: 1000,
        }
    }
}

/// Learning rates of Adam by group (Kerbl et al. 2023).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Of means at the first step, times the scene's extent.
    pub means: f64,
    /// Of means at the last step, times the scene's extent; log-linear between.
    pub means_final: f64,
    /// Of log scales.
    pub scales: f64,
    /// Of quaternions.
    pub rotations: f64,
    /// Of opacity logits.
    pub opacities: f64,
    /// Of band 0.
    pub sh0: f64,
    /// Of the other bands.
    pub sh_rest: f64,
    /// Of normals.
    pub normals: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Rates {
            means: 1.6e-4,
            means_final: 1.6e-6,
            scales: 5e-3,
            rotations: 1e-3,
            opacities: 0.05,
            sh0: 2.5e-3,
            sh_rest: 1.25e-4,
            normals: 0.01,
        }
    }
}

/// Weights of the losses (SGS-Intrinsic, stage I).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Mean absolute difference.
    pub l1: f32,
    /// One minus SSIM.
    pub dssim: f32,
    /// One minus the cosine to the normal prior.
    pub normal: f32,
    /// Edge-aware smoothness of the normals.
    pub normal_smooth: f32,
    /// Edge-aware smoothness of depth.
    pub depth_smooth: f32,
    /// Spread of depth along a ray at step 0; grows tenfold every 5000 steps, a hundredfold at most.
    pub depth_variance: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        LossWeights {
            l1: 0.8,
            dssim: 0.2,
            normal: 0.05,
            normal_smooth: 0.01,
            depth_smooth: 0.01,
            depth_variance: 0.02,
        }
    }
}

/// Which gradient decides where Gaussians are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Statistic {
    /// That of all losses, as one pass gives it.
    Sum,
}

/// Densification (Kerbl et al. 2023, section 5.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensifyOptions {
    /// Whether it happens at all.
    pub enabled: bool,
    /// First step after which it happens.
    pub from: u32,
    /// Fraction of the steps after which it ends.
    pub until: f64,
    /// Steps between.
    pub interval: u32,
    /// Mean screen gradient (NDC) from which a Gaussian is refined.
    pub grad_threshold: f32,
    /// Largest scale that is cloned rather than split, as a fraction of the extent.
    pub split_size: f64,
    /// Fainter Gaussians are pruned.
    pub prune_opacity: f32,
    /// Gaussians that gathered less blending weight since the last time are pruned.
    pub prune_weight: f32,
    /// Larger Gaussians are pruned after the first opacity reset, as a fraction of the extent.
    pub prune_size: f64,
    /// Steps between opacity resets; 0 for none.
    pub reset_interval: u32,
    /// Most Gaussians.
    pub max_gaussians: u32,
}

impl Default for DensifyOptions {
    fn default() -> Self {
        DensifyOptions {
            enabled: true,
            from: 500,
            until: 0.8,
            interval: 100,
            grad_threshold: 2e-4,
            split_size: 0.01,
            prune_opacity: 0.005,
            prune_weight: 1e-4,
            prune_size: 0.5,
            reset_interval: 3000,
            max_gaussians: 2_000_000,
        }
    }
}

impl Settings {
    /// Checks what types cannot.
    ///
    /// # Errors
    /// A sentence that names the setting, its value and what it may be.
    pub fn check(&self) -> crate::Result<()> {
        let fail = |what: String| Err(crate::TrainError::Setting(what));
        let g = &self.geometry;
        if g.sh_degree > 3 {
            return fail(format!("geometry.sh_degree is {}, but must be 0 to 3.", g.sh_degree));
        }
        if !(self.scale > 0.0 && self.scale <= 1.0) {
            return fail(format!("scale is {}, but must be above 0 and at most 1.", self.scale));
        }
        let r = &g.rates;
        for (name, value) in [
            ("means", r.means),
            ("means_final", r.means_final),
            ("scales", r.scales),
            ("rotations", r.rotations),
            ("opacities", r.opacities),
            ("sh0", r.sh0),
            ("sh_rest", r.sh_rest),
            ("normals", r.normals),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return fail(format!("geometry.rates.{name} is {value}, but must be a finite number of at least 0."));
            }
        }
        let d = &g.densify;
        if d.enabled && d.interval == 0 {
            return fail("geometry.densify.interval is 0, but must be at least 1.".into());
        }
        if d.max_gaussians == 0 {
            return fail("geometry.densify.max_gaussians is 0, but must be at least 1.".into());
        }
        Ok(())
    }
}

//! Settings of a training: presets, files and single overrides.

use crate::refuse_usage;
use sgs_config::{Preset, Settings, accuracy_named, overlay};
use sgs_run::StageKind;
use sgs_scene::SplitRule;
use std::path::Path;

/// Overrides of default settings. Absent values change nothing.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Name of a preset.
    pub preset: Option<String>,
    /// Accuracy level: `exact`, `compact`, `balanced` or `fast`.
    pub accuracy: Option<String>,
    /// Settings as in `config.toml`.
    pub config: Option<toml::Table>,
    /// Single settings by their paths, as `geometry.rates.means`.
    pub set: Vec<(String, toml::Value)>,
    /// Steps of the geometry stage.
    pub geometry_steps: Option<u32>,
    /// Steps of the intrinsic stage.
    pub intrinsic_steps: Option<u32>,
    /// Views held out for tests.
    pub split: Option<SplitRule>,
    /// Number of training views.
    pub views: Option<usize>,
    /// Factor on the size of the images.
    pub scale: Option<f64>,
    /// Disables densification.
    pub no_densify: bool,
    /// Seed of all random numbers.
    pub seed: Option<u64>,
    /// Maximum device memory of training in bytes.
    pub memory_budget: Option<u64>,
}

/// Returns the settings of a training.
///
/// Later sources override earlier ones: preset, accuracy level, file, single settings, other overrides.
///
/// # Errors
/// If a name, a setting or a value is wrong.
pub fn settings(scene: &Path, o: &Overrides) -> anyhow::Result<Settings> {
    let mut table = preset_of(o)?;
    overlay(&mut table, accuracy_of(o)?);
    overlay(&mut table, o.config.clone().unwrap_or_default());
    settings_over(table, scene, o)
}

/// Returns the settings of the preset.
fn preset_of(o: &Overrides) -> anyhow::Result<toml::Table> {
    match &o.preset {
        None => Ok(toml::Table::new()),
        Some(name) => Ok(Preset::find(name)?.table()?),
    }
}

/// Returns the settings of the accuracy level.
pub(crate) fn accuracy_of(o: &Overrides) -> anyhow::Result<toml::Table> {
    match &o.accuracy {
        None => Ok(toml::Table::new()),
        Some(name) => Ok(accuracy_named(name)?),
    }
}

/// Returns settings of a stage on the Gaussians of a run.
///
/// The base is the settings of the run, which produced the Gaussians. Preset, accuracy level and file override
/// settings of the stage, in this order.
pub(crate) fn settings_of_stage(
    stage: StageKind,
    run: &Settings,
    scene: &Path,
    o: &Overrides,
) -> anyhow::Result<Settings> {
    let mut table = run.to_table()?;
    let of_stage = |mut over: toml::Table| -> anyhow::Result<toml::Table> {
        // Checks the names of the other settings, too, before dropping them.
        Settings::from_table(over.clone())?;
        over.retain(|key, _| key == stage.name());
        Ok(over)
    };
    overlay(&mut table, of_stage(preset_of(o)?)?);
    if stage == StageKind::Intrinsic {
        overlay(&mut table, accuracy_of(o)?);
    }
    overlay(&mut table, of_stage(o.config.clone().unwrap_or_default())?);
    settings_over(table, scene, o)
}

/// Returns the settings of a table, overridden by single settings and the rest.
pub(crate) fn settings_over(mut table: toml::Table, scene: &Path, o: &Overrides) -> anyhow::Result<Settings> {
    for (key, value) in &o.set {
        set(&mut table, key, value.clone())?;
    }
    let mut s = Settings::from_table(table)?;
    // The run may be opened from another directory.
    s.scene = std::path::absolute(scene).unwrap_or_else(|_| scene.to_owned());
    if let Some(n) = o.geometry_steps {
        s.geometry.steps = n;
    }
    if let Some(n) = o.intrinsic_steps {
        s.intrinsic.steps = n;
    }
    if let Some(rule) = &o.split {
        s.split = rule.clone();
    }
    if let SplitRule::File(path) = &mut s.split {
        *path = std::path::absolute(&path).unwrap_or_else(|_| path.clone());
    }
    if let Some(n) = o.views {
        s.views = n;
    }
    if let Some(f) = o.scale {
        s.scale = f;
    }
    if o.no_densify {
        s.geometry.densify.until = 0.0;
    }
    if let Some(seed) = o.seed {
        s.seed = seed;
    }
    if let Some(bytes) = o.memory_budget {
        s.memory.budget = bytes;
    }
    s.check()?;
    if o.views == Some(0) {
        refuse_usage!("--views is 0, but there must be at least one training view.");
    }
    Ok(s)
}

/// Sets one setting, named by its path.
fn set(table: &mut toml::Table, key: &str, value: toml::Value) -> anyhow::Result<()> {
    let mut parts: Vec<&str> = key.split('.').collect();
    let Some(last) = parts.pop().filter(|l| !l.is_empty()) else {
        refuse_usage!("--set has no key before \"={value}\".");
    };
    let mut at = table;
    for part in parts {
        let entry = at.entry(part).or_insert_with(|| toml::Value::Table(toml::Table::new()));
        let toml::Value::Table(inner) = entry else {
            refuse_usage!("\"{key}\" is not a setting: \"{part}\" is a value.");
        };
        at = inner;
    }
    at.insert(last.to_owned(), value);
    Ok(())
}

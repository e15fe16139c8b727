//! The choices of both stages, each as a user would ask for it: what is measured is what that comes to as settings.

use anyhow::{Context, ensure};
use sgs_passes::Tuning;
use sgs_train::{Settings, accuracy_named, overlay};

/// By how much gradients may differ that are sums of the same in another order; tests hold gradients to as much of finite differences.
const ROUNDING: f64 = 1e-3;

/// What a choice changes, and so what it can be held to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The way to the same numbers: a step comes to what that of `exact` does, up to rounding, so that nothing is traded.
    Same,
    /// How close a step comes.
    Accuracy,
    /// What becomes of later steps alone: what it costs shows in no single one, but in a training.
    Later,
    /// What is learned: there are no gradients to compare.
    Model,
}

/// One way to do it.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Short.
    pub name: String,
    /// As a user would ask for it.
    pub setting: String,
    /// What it changes.
    pub kind: Kind,
    /// What differs from the settings that all have.
    over: toml::Table,
}

impl Choice {
    /// What is asked is `--accuracy NAME` first, if at all, and `KEY=VALUE` as `--set` takes it.
    pub fn new(name: &str, asks: &[&str], kind: Kind) -> anyhow::Result<Choice> {
        let mut over = toml::Table::new();
        for ask in asks {
            let table = match ask.strip_prefix("--accuracy ") {
                Some(level) => accuracy_named(level)?,
                None => set(ask)?,
            };
            overlay(&mut over, table);
        }
        let setting: Vec<String> = asks.iter().map(|ask| format!("`{ask}`")).collect();
        Ok(Choice { name: name.to_owned(), setting: setting.join(", "), kind, over })
    }

    /// A level of accuracy.
    pub fn level(name: &str) -> anyhow::Result<Choice> {
        Choice::new(name, &[&format!("--accuracy {name}")], Kind::Accuracy)
    }

    /// The settings that it is.
    pub fn settings(&self, base: &Settings) -> anyhow::Result<Settings> {
        let mut table = base.to_table()?;
        overlay(&mut table, self.over.clone());
        let settings = Settings::from_table(table)?;
        settings.check()?;
        Ok(settings)
    }

    /// The error of its gradient, if that is what may be of such a choice.
    ///
    /// # Errors
    /// If it should come to the same as `exact` and does not.
    pub fn held(&self, gradient: f64) -> anyhow::Result<f64> {
        let held = self.kind != Kind::Same || gradient <= ROUNDING;
        ensure!(held, "\"{}\" should come to the same as exact, but its gradient is {gradient:.1e} off.", self.name);
        Ok(gradient)
    }

    /// Whether what it costs shows in one step.
    pub fn shows(&self) -> bool {
        matches!(self.kind, Kind::Same | Kind::Accuracy)
    }
}

/// A setting as a table; a word need not be quoted.
fn set(pair: &str) -> anyhow::Result<toml::Table> {
    let (key, value) = pair.split_once('=').with_context(|| format!("\"{pair}\" sets nothing."))?;
    let quoted = || format!("{key} = \"{value}\"").parse();
    format!("{key} = {value}").parse().or_else(|_| quoted()).with_context(|| format!("\"{pair}\""))
}

/// Of the geometry stage: `exact` first, then every choice alone, then levels of accuracy, then other ways to the same. Those of
/// features where there are some.
pub fn of_geometry(own: &Tuning, semantics: bool) -> anyhow::Result<Vec<Choice>> {
    let mut all = vec![Choice::level("exact")?];
    let mut add = |name: &str, asks: &[&str], kind: Kind| -> anyhow::Result<()> {
        all.push(Choice::new(name, asks, kind)?);
        Ok(())
    };
    for bits in [24, 16] {
        add(&format!("depth of {bits} bits"), &[&format!("accuracy.depth_bits={bits}")], Kind::Accuracy)?;
    }
    for parts in [128.0_f32, 64.0, 32.0] {
        let ask = format!("accuracy.alpha_min={}", 1.0 / parts);
        add(&format!("alpha from 1/{parts}"), &[&ask], Kind::Accuracy)?;
    }
    add("last splat kept", &["accuracy.keep_last=true"], Kind::Accuracy)?;
    for least in ["0.001", "0.01", "0.05"] {
        let asks = [&format!("accuracy.transmittance_min={least}"), "accuracy.keep_last=true"];
        add(&format!("transmittance to {least}, last splat kept"), &asks, Kind::Accuracy)?;
    }
    add("cubic for exp", &["accuracy.fast_exp=true"], Kind::Accuracy)?;
    add("colors in 16 bits", &["accuracy.color_bits=16"], Kind::Accuracy)?;
    if semantics {
        add("features in 16 bits", &["accuracy.feature_bits=16"], Kind::Accuracy)?;
    }
    for level in ["balanced", "fast"] {
        add(level, &[&format!("--accuracy {level}")], Kind::Accuracy)?;
    }
    if semantics {
        add("fast, features in 16 bits", &["--accuracy fast", "accuracy.feature_bits=16"], Kind::Accuracy)?;
    }
    let [width, height] = own.tile;
    for rows in [height / 2, height * 2] {
        add(&format!("tiles of {width}x{rows}"), &[&format!("train.tile_rows={rows}")], Kind::Same)?;
    }
    add("backward by splats", &["geometry.backward=splat"], Kind::Same)?;
    add("backward by atomics", &["geometry.backward=atomic"], Kind::Same)?;
    // Of one step; its trajectory is another.
    add("Adam of all", &["geometry.dense_adam=true"], Kind::Same)?;
    Ok(all)
}

/// Of the intrinsic stage with these settings: `exact` first, then every choice alone, then levels of accuracy, then all together,
/// then other models.
pub fn of_intrinsic(base: &Settings, own: &Tuning) -> anyhow::Result<Vec<Choice>> {
    let mut all = vec![Choice::level("exact")?];
    let mut add = |name: &str, asks: &[&str], kind: Kind| -> anyhow::Result<()> {
        all.push(Choice::new(name, asks, kind)?);
        Ok(())
    };
    add("weights anew", &["intrinsic.surface_bytes=1"], Kind::Same)?;
    add("surroundings every 4", &["intrinsic.environment.every=4"], Kind::Later)?;
    add("surroundings every 8", &["intrinsic.environment.every=8"], Kind::Later)?;
    add("one pair of 4", &["intrinsic.visibility.sample=4"], Kind::Accuracy)?;
    add("one pair of 16", &["intrinsic.visibility.sample=16"], Kind::Accuracy)?;
    add("lights culled, 0.002", &["intrinsic.cull_error=0.002"], Kind::Accuracy)?;
    add("lights culled, 0.02", &["intrinsic.cull_error=0.02"], Kind::Accuracy)?;
    add("half size", &["intrinsic.scale=0.5"], Kind::Accuracy)?;
    add("weights in 16 bits", &["accuracy.weight_bits=16"], Kind::Accuracy)?;
    add("tables in 16 bits", &["accuracy.table_bits=16"], Kind::Accuracy)?;
    if own.matrices.is_some() {
        add("field in 16 bits", &["accuracy.visibility_operands=16"], Kind::Accuracy)?;
    }
    let rows = own.tile[1];
    for (name, rows) in [("tiles of half the rows", rows / 2), ("tiles of twice the rows", rows * 2)] {
        add(name, &[&format!("train.tile_rows={rows}")], Kind::Same)?;
    }
    for level in ["balanced", "fast"] {
        add(level, &[&format!("--accuracy {level}")], Kind::Accuracy)?;
    }
    let draft = ["--accuracy fast", "intrinsic.cull_error=0.02", "intrinsic.scale=0.5"];
    add("fast, culled, half size", &draft, Kind::Accuracy)?;
    let s = &base.intrinsic;
    if s.lights.grid > 1 {
        add("fewer lights", &[&format!("intrinsic.lights.grid={}", s.lights.grid - 1)], Kind::Model)?;
    }
    if s.lights.lobes > 1 {
        add("fewer lobes", &[&format!("intrinsic.lights.lobes={}", s.lights.lobes / 2)], Kind::Model)?;
    }
    if s.environment.resolution > 16 {
        let half = s.environment.resolution / 2;
        add("coarser surroundings", &[&format!("intrinsic.environment.resolution={half}")], Kind::Model)?;
    }
    if s.visibility.levels > 4 {
        let levels = s.visibility.levels / 2;
        let ratio = f64::from(s.visibility.finest) / f64::from(s.visibility.coarsest.max(1));
        let finest =
            f64::from(s.visibility.coarsest) * ratio.powf(f64::from(levels - 1) / f64::from(s.visibility.levels - 1));
        let asks = [("levels", f64::from(levels)), ("finest", finest.round())];
        let asks = asks.map(|(key, value)| format!("intrinsic.visibility.{key}={value}"));
        add("half of the field", &asks.each_ref().map(String::as_str), Kind::Model)?;
    }
    Ok(all)
}

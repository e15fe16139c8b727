//! Settings recorded in a report, so that only choices of the same settings are compared.

use super::Args;
use super::choices::set;
use crate::report::{FILTER, Report};
use sgs_config::{Settings, overlay};

/// Records it.
///
/// # Errors
/// If settings cannot be written.
pub fn record(report: &mut Report, a: &Args, base: &Settings) -> anyhow::Result<()> {
    report.setting("settings", differing(base)?);
    report.setting(FILTER, a.filter.clone().unwrap_or_default());
    report.setting("rounds", a.rounds);
    report.setting("geometry", if a.geometry.is_some() { "given" } else { "made" });
    Ok(())
}

/// The settings that were recorded; none in reports from before they were.
///
/// # Errors
/// If they are no settings.
pub fn recorded(report: &Report) -> anyhow::Result<Option<Settings>> {
    let Some(text) = report.setting_text("settings") else { return Ok(None) };
    let mut table = Settings::default().to_table()?;
    if text == DEFAULTS {
        return Ok(Some(Settings::default()));
    }
    // Lists have commas of their own.
    let mut all: Vec<String> = Vec::new();
    for part in text.split(", ") {
        match all.last_mut() {
            Some(list) if !part.contains('=') => *list += &format!(", {part}"),
            _ => all.push(part.to_owned()),
        }
    }
    for pair in &all {
        overlay(&mut table, set(pair)?);
    }
    Ok(Some(Settings::from_table(table)?))
}

/// Of settings that are.
const DEFAULTS: &str = "the defaults";

/// Settings that are not the defaults, as `--set` would take them. The scene has its own setting, and its folder is private.
pub fn differing(settings: &Settings) -> anyhow::Result<String> {
    let (mut own, defaults) = (settings.to_table()?, Settings::default().to_table()?);
    own.remove("scene");
    let mut all = Vec::new();
    collect("", &own, &defaults, &mut all);
    Ok(if all.is_empty() { DEFAULTS.to_owned() } else { all.join(", ") })
}

fn collect(prefix: &str, own: &toml::Table, defaults: &toml::Table, all: &mut Vec<String>) {
    for (key, value) in own {
        let (name, default) = (format!("{prefix}{key}"), defaults.get(key));
        match (value, default) {
            (toml::Value::Table(own), Some(toml::Value::Table(defaults))) => {
                collect(&format!("{name}."), own, defaults, all);
            }
            (toml::Value::Float(v), d) if d != Some(value) => {
                // Most are of single precision, and have more digits than were meant.
                let short = *v as f32;
                let text = if f64::from(short) == *v { short.to_string() } else { v.to_string() };
                all.push(format!("{name}={text}"));
            }
            (_, d) if d != Some(value) => all.push(format!("{name}={value}")),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The small setting of docs/project/ablation.md, without the settings of accuracy levels.
    #[test]
    fn small_preset_matches_its_description() {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("small.toml");
        let small = crate::workload::lit_settings(Some(&file)).unwrap();
        small.check().unwrap();
        assert_eq!(
            differing(&small).unwrap(),
            "intrinsic.environment.resolution=32, intrinsic.lights.grid=3, intrinsic.rates.albedo=0.03, \
             intrinsic.rates.metallic=0.03, intrinsic.rates.roughness=0.03, intrinsic.relight_from=50, \
             intrinsic.visibility.finest=256, intrinsic.visibility.levels=8, intrinsic.visibility.log2_table=14"
        );
    }

    #[test]
    fn non_default_settings_are_recorded() {
        assert_eq!(differing(&Settings::default()).unwrap(), "the defaults");
        let mut s = Settings { scene: "somewhere".into(), ..Settings::default() };
        assert_eq!(differing(&s).unwrap(), "the defaults");
        s.intrinsic.visibility.levels = 8;
        s.intrinsic.rates.albedo = 0.03;
        s.geometry.densify.enabled = false;
        s.scale = 0.3;
        let differences = differing(&s).unwrap();
        assert_eq!(
            differences,
            "geometry.densify.enabled=false, intrinsic.rates.albedo=0.03, intrinsic.visibility.levels=8, scale=0.3"
        );
        // And is found again in a report.
        let mut report = super::super::again::report(&[]);
        assert_eq!(recorded(&report).unwrap(), None);
        for settings in [Settings { scene: "".into(), ..s.clone() }, Settings::default()] {
            report.setting("settings", differing(&settings).unwrap());
            assert_eq!(recorded(&report).unwrap().unwrap(), settings);
        }
        report.setting("settings", "geometry.background=[0.5, 0.25, 1], train.tile_rows=8");
        let found = recorded(&report).unwrap().unwrap();
        assert_eq!((found.geometry.background, found.train.tile_rows), ([0.5, 0.25, 1.0], 8));
        // Every other size, rate and level is another report.
        let others: [fn(&mut Settings); 6] = [
            |s| s.intrinsic.visibility.finest = 256,
            |s| s.intrinsic.rates.metallic = 0.03,
            |s| s.intrinsic.environment.resolution = 32,
            |s| s.intrinsic.lights.lobes = 6,
            |s| s.intrinsic.scale = 0.5,
            |s| s.intrinsic.losses.relight = 0.0,
        ];
        for change in others {
            let mut other = s.clone();
            change(&mut other);
            assert_ne!(differing(&other).unwrap(), differences);
        }
    }
}

//! Settings recorded in a report.
//!
//! Only reports of equal settings are compared.

use super::Args;
use super::choices::set;
use crate::report::{FILTER, Report};
use sgs_config::{Settings, overlay};

/// Records settings, filter, number of rounds and origin of the geometry.
///
/// # Errors
/// If the settings cannot be serialized.
pub fn record(report: &mut Report, a: &Args, base: &Settings) -> anyhow::Result<()> {
    report.setting("settings", differing(base)?);
    report.setting(FILTER, a.filter.clone().unwrap_or_default());
    report.setting("rounds", a.rounds);
    report.setting("geometry", if a.geometry.is_some() { "given" } else { "made" });
    Ok(())
}

/// Returns the recorded settings; `None` for reports that predate the record.
///
/// # Errors
/// If the recorded text is not valid settings.
pub fn recorded(report: &Report) -> anyhow::Result<Option<Settings>> {
    let Some(text) = report.setting_text("settings") else { return Ok(None) };
    let mut table = Settings::default().to_table()?;
    if text == DEFAULTS {
        return Ok(Some(Settings::default()));
    }
    // Lists contain commas, too.
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

/// Recorded text if all settings have their defaults.
const DEFAULTS: &str = "the defaults";

/// Returns the settings that differ from the defaults, in the syntax of `--set`.
///
/// The scene is excluded: it has its own entry, and its path is private.
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
                // Most values are single precision; as double precision they print more digits than were set.
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

    /// Compares with the small setting of docs/project/ablation.md. Excludes the settings of accuracy levels.
    #[test]
    fn small_preset_matches_its_description() {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("small.toml");
        let small = crate::workload::lit_settings(Some(&file)).unwrap();
        small.check().unwrap();
        assert_eq!(
            differing(&small).unwrap(),
            "intrinsic.environment.resolution=32, intrinsic.lights.grid=3, intrinsic.rates.materials=0.03, \
             intrinsic.relight_from=50, intrinsic.visibility.finest=256, intrinsic.visibility.levels=8, intrinsic.visibility.log2_table=14"
        );
    }

    #[test]
    fn non_default_settings_are_recorded() {
        assert_eq!(differing(&Settings::default()).unwrap(), "the defaults");
        let mut s = Settings { scene: "somewhere".into(), ..Settings::default() };
        assert_eq!(differing(&s).unwrap(), "the defaults");
        s.intrinsic.visibility.levels = 8;
        s.intrinsic.rates.materials = 0.03;
        s.geometry.densify.until = 0.0;
        s.scale = 0.3;
        let differences = differing(&s).unwrap();
        assert_eq!(
            differences,
            "geometry.densify.until=0, intrinsic.rates.materials=0.03, intrinsic.visibility.levels=8, scale=0.3"
        );
        // The record parses back to the same settings.
        let mut report = super::super::again::report(&[]);
        assert_eq!(recorded(&report).unwrap(), None);
        for settings in [Settings { scene: "".into(), ..s.clone() }, Settings::default()] {
            report.setting("settings", differing(&settings).unwrap());
            assert_eq!(recorded(&report).unwrap().unwrap(), settings);
        }
        report.setting("settings", "geometry.background=[0.5, 0.25, 1], train.tile_rows=8");
        let found = recorded(&report).unwrap().unwrap();
        assert_eq!((found.geometry.background, found.train.tile_rows), ([0.5, 0.25, 1.0], 8));
        // Any other size, rate or level gives another record.
        let others: [fn(&mut Settings); 6] = [
            |s| s.intrinsic.visibility.finest = 256,
            |s| s.intrinsic.rates.lights = 0.1,
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

//! Settings of a configuration.

use crate::error::computed;
use pyo3::prelude::*;
use sgs_api::{Overrides, usage};
use std::path::Path;

/// Preset, accuracy level, and settings as JSON.
pub type ConfigTuple = (Option<String>, Option<String>, Option<String>);

/// Returns the overrides of a configuration.
pub fn overrides((preset, accuracy, json): ConfigTuple) -> anyhow::Result<Overrides> {
    let config = match json {
        None => None,
        Some(json) => Some(
            serde_json::from_str(&json)
                .map_err(|e| usage(format!("The settings are not numbers, strings, lists and groups: {e}.")))?,
        ),
    };
    Ok(Overrides { preset, accuracy, config, ..Overrides::default() })
}

/// Checks a configuration. Returns all settings as JSON.
#[pyfunction]
pub fn check_settings(py: Python<'_>, config: ConfigTuple) -> PyResult<String> {
    computed(py, || {
        let mut table = sgs_api::settings(Path::new("."), &overrides(config)?)?.to_table()?;
        table.remove("scene");
        Ok(serde_json::to_string(&table)?)
    })
}

//! Devices.

use crate::error::{computed, raised};
use pyo3::prelude::*;
use sgs_api::{cache_folder, usage};
use sgs_engine::{DeviceOptions, Environment, select_auto};
use std::time::Duration;

/// Open device.
#[pyclass(frozen, module = "sgs._sgs")]
pub struct Device(pub sgs_engine::Device);

#[pymethods]
impl Device {
    #[new]
    #[pyo3(signature = (select=None, timeout=None))]
    fn new(py: Python<'_>, select: Option<String>, timeout: Option<f64>) -> PyResult<Device> {
        computed(py, || {
            let defaults = DeviceOptions::default();
            let timeout = match timeout {
                None => defaults.timeout,
                Some(s) => Duration::try_from_secs_f64(s)
                    .ok()
                    .filter(|d| !d.is_zero())
                    .ok_or_else(|| usage(format!("timeout is {s}, but must be a number of seconds above 0.")))?,
            };
            let options = DeviceOptions { select, pipeline_cache: cache_folder(), timeout, ..defaults };
            Ok(Device(sgs_engine::Device::open(&options)?))
        })
    }

    /// Returns what is known about the device, as JSON.
    fn info(&self) -> PyResult<String> {
        serde_json::to_string(self.0.info()).map_err(|e| raised(&e.into()))
    }

    /// Returns the bytes of device memory in use, and their peak.
    fn memory(&self) -> (u64, u64) {
        self.0.memory_use()
    }
}

/// Returns all devices as JSON: what is known about each, and why one is selected by default.
#[pyfunction]
pub fn devices(py: Python<'_>) -> PyResult<String> {
    computed(py, || {
        let devices = sgs_engine::devices()?;
        let chosen = select_auto(&devices, &Environment::current());
        let mut rows = Vec::new();
        for info in &devices {
            let mut row = serde_json::to_value(info)?;
            if let Some(choice) = chosen.as_ref().ok().filter(|choice| choice.index == info.index) {
                row["auto"] = choice.reason.clone().into();
            }
            rows.push(row);
        }
        Ok(serde_json::to_string(&rows)?)
    })
}

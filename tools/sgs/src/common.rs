//! Options that every command has. Opens the device that they select.

use clap::Args;
use sgs_engine::{Device, DeviceOptions};
use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

/// Options of every command.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Options of every command")]
pub struct Common {
    /// Device by index, part of its name, UUID or PCI address. "auto", the default, is the first one that
    /// CUDA_VISIBLE_DEVICES and such variables name, else the best (docs/reference/devices.md).
    #[arg(long, global = true, value_name = "INDEX|NAME|uuid:…|pci:…|auto")]
    pub device: Option<String>,
    /// Write the result as JSON to standard output, or to FILE. Its name ends in .json.
    #[arg(long, global = true, num_args = 0..=1, default_missing_value = "-", value_name = "FILE", require_equals = true)]
    pub json: Option<PathBuf>,
    /// Log more messages; twice logs all.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Log errors only.
    #[arg(short, long, global = true)]
    pub quiet: bool,
    /// Time limit of a wait for the device, in seconds.
    #[arg(long, global = true, value_name = "SECONDS", value_parser = seconds)]
    pub timeout: Option<Duration>,
    /// Run with Vulkan validation; any message is an error.
    #[arg(long, global = true, hide = true)]
    pub validate: bool,
}

impl Common {
    /// Opens the selected device.
    pub fn open_device(&self) -> anyhow::Result<Device> {
        Ok(Device::open(&self.device_options())?)
    }

    /// Returns the options with which devices are opened.
    pub fn device_options(&self) -> DeviceOptions {
        let defaults = DeviceOptions::default();
        DeviceOptions {
            select: self.device.clone(),
            validation: self.validate,
            pipeline_cache: sgs_api::cache_folder(),
            timeout: self.timeout.unwrap_or(defaults.timeout),
            ..defaults
        }
    }

    /// Extracts `--json` from arguments that clap cannot parse. `None` without `--json`.
    ///
    /// All other options have their defaults.
    pub fn json_only(arguments: &[OsString]) -> Option<Common> {
        let value = arguments.iter().find_map(|argument| match argument.to_str()? {
            "--json" => Some("-"),
            text => text.strip_prefix("--json="),
        });
        let json = Some(PathBuf::from(value?));
        Some(Common { device: None, json, verbose: 0, quiet: false, timeout: None, validate: false })
    }

    /// Writes the result as JSON if `--json` is set.
    ///
    /// Returns true if it went to standard output, which must then receive nothing else.
    pub fn answer(&self, value: &impl serde::Serialize) -> anyhow::Result<bool> {
        let Some(path) = &self.json else { return Ok(false) };
        let text = serde_json::to_string_pretty(value)?;
        if path.as_os_str() == "-" {
            println!("{text}");
            return Ok(true);
        }
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
        Ok(false)
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let value = text.parse::<f64>().ok().filter(|s| *s > 0.0);
    value.and_then(|s| Duration::try_from_secs_f64(s).ok()).ok_or_else(|| "a number of seconds above 0".into())
}

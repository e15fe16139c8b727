//! Options of every command. Opens the device that they select.

use crate::report::compare::compare;
use crate::report::set::ReportSet;
use crate::report::{DeviceLine, Report};
use anyhow::Context;
use clap::Args;
use sgs_engine::{Device, DeviceOptions};
use std::path::PathBuf;

/// Options of every command.
#[derive(Args, Clone, Debug)]
pub struct Common {
    /// Device by index or part of its name (see `sgs devices`); by default the best.
    #[arg(long, global = true, value_name = "INDEX|NAME")]
    pub device: Option<String>,
    /// Write the report as JSON to FILE. Without FILE, to standard output in place of the tables.
    #[arg(long, global = true, num_args = 0..=1, default_missing_value = "-", value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Number of measured repetitions.
    #[arg(long, global = true, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..))]
    pub repeats: u32,
    /// Number of unmeasured repetitions before the measured ones.
    #[arg(long, global = true, value_name = "N", default_value_t = 3)]
    pub warmup: u32,
    /// Fail if a time or other figure is worse than in this report beyond the noise. The report is of the same command.
    #[arg(long, global = true, value_name = "BASELINE.json")]
    pub compare: Option<PathBuf>,
    /// Fraction of the baseline by which a slowdown always counts as noise.
    #[arg(long, global = true, value_name = "SHARE", default_value_t = 0.05)]
    pub tolerance: f64,
    /// Time limit of a wait for the device, in seconds.
    #[arg(long, global = true, value_name = "SECONDS", default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..))]
    pub timeout: u64,
    /// Run with Vulkan validation; any message is an error. Times are then not representative.
    #[arg(long, global = true, hide = true)]
    pub validate: bool,
}

impl Common {
    /// Opens the requested device.
    pub fn open_device(&self) -> anyhow::Result<Device> {
        self.open_with_statistics(false)
    }

    /// Opens the requested device, which may report statistics of its kernels.
    pub fn open_with_statistics(&self, kernel_statistics: bool) -> anyhow::Result<Device> {
        let options = DeviceOptions {
            kernel_statistics,
            select: self.device.clone(),
            validation: self.validate,
            timeout: std::time::Duration::from_secs(self.timeout),
            ..Default::default()
        };
        Ok(Device::open(&options)?)
    }

    /// Creates an empty report of a command on a device.
    pub fn report(&self, command: &str, device: &Device) -> Report {
        let info = device.info();
        let device = DeviceLine {
            name: info.name.clone(),
            kind: info.kind.to_owned(),
            driver: info.driver.trim().to_owned(),
            api: info.api.clone(),
            subgroup_size: info.subgroup_size,
        };
        Report::new(command, device, self.repeats, self.warmup)
    }

    /// Prints and writes the report, and compares it with the baseline.
    ///
    /// # Errors
    /// If a figure is not finite, a file cannot be read or written, validation reported a message, or a figure is
    /// worse.
    pub fn finish(&self, report: &Report, device: &Device) -> anyhow::Result<()> {
        report.ensure_finite()?;
        let text = serde_json::to_string_pretty(report).context("The report cannot be written as JSON.")?;
        match &self.json {
            Some(path) if path.as_os_str() == "-" => println!("{text}"),
            other => {
                print!("{}", report.text());
                if let Some(path) = other {
                    sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
                }
            }
        }
        if let Some(first) = device.messages().take().first() {
            anyhow::bail!("Validation reported: {first}");
        }
        let Some(path) = &self.compare else { return Ok(()) };
        let baseline = ReportSet::read(path)?;
        let outcome = compare(baseline.like(report)?, report, self.tolerance)?;
        eprint!("{}", outcome.text());
        anyhow::ensure!(
            outcome.slower.is_empty(),
            "{} of {} figures are worse than in \"{}\".",
            outcome.slower.len(),
            outcome.compared,
            path.display()
        );
        Ok(())
    }
}

/// Parses a size of the form `WIDTHxHEIGHT`.
pub fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let side = |t: &str| t.trim().parse::<u32>().ok().filter(|n| (1..=16_384).contains(n));
    match text.split_once(['x', 'X', '×']).map(|(w, h)| (side(w), side(h))) {
        Some((Some(w), Some(h))) => Ok([w, h]),
        _ => Err("a size looks like 640x480, with sides of 1 to 16384".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn valid_sizes_are_parsed_and_others_refused() {
        assert_eq!(parse_size("640x480"), Ok([640, 480]));
        assert!(["640", "0x3", "3x", "-1x4", "99999x2"].iter().all(|t| parse_size(t).is_err()));
    }
}

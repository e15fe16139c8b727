//! Files and table of reports: `engine-bench join` and `engine-bench table`.
//!
//! Joins reports to one file per device, and prints the table of docs/project/benchmarks.md.

use crate::report::set::{ReportSet, table};
use std::path::PathBuf;

/// Options of `join`.
#[derive(clap::Args, Clone, Debug)]
pub struct Join {
    /// Report files of one device.
    #[arg(required = true)]
    reports: Vec<PathBuf>,
    /// File for all reports.
    #[arg(short, long, value_name = "FILE.json")]
    output: PathBuf,
}

/// Options of `table`.
#[derive(clap::Args, Clone, Debug)]
pub struct Table {
    /// Report files.
    #[arg(required = true)]
    files: Vec<PathBuf>,
}

/// Writes one file with all reports.
///
/// # Errors
/// If the reports cannot be read or joined, or the file cannot be written.
pub fn join(a: &Join) -> anyhow::Result<()> {
    let sets = a.reports.iter().map(|path| ReportSet::read(path)).collect::<anyhow::Result<_>>()?;
    let text = serde_json::to_string_pretty(&ReportSet::join(sets)?)?;
    Ok(sgs_scene::atomic_write(&a.output, |f| std::io::Write::write_all(f, text.as_bytes()))?)
}

/// Prints the table in Markdown.
///
/// # Errors
/// If a file cannot be read.
pub fn print(a: &Table) -> anyhow::Result<()> {
    let sets: Vec<ReportSet> = a.files.iter().map(|path| ReportSet::read(path)).collect::<anyhow::Result<_>>()?;
    print!("{}", table(&sets));
    Ok(())
}

//! `sgs export`: a run's Gaussians for viewers.

use crate::cameras::splats_of;
use crate::common::Common;
use anyhow::bail;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Args {
    /// Run directory.
    run: PathBuf,
    /// PLY file to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if a.output.extension().is_none_or(|e| !e.eq_ignore_ascii_case("ply")) {
        bail!("\"{}\" does not end in .ply, the format that is written.", a.output.display());
    }
    let (splats, _) = splats_of(&a.run)?;
    splats.write_ply(&a.output)?;
    if !common.answer(&serde_json::json!({"gaussians": splats.len(), "file": a.output}))? && !common.quiet {
        eprintln!("wrote {} Gaussians to {}", splats.len(), a.output.display());
    }
    Ok(())
}

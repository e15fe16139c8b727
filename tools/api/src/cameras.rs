//! Loads Gaussians that the command line names.

use anyhow::{Context, bail};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::scene::{Gaussians, Model};
use sgs_run::{RunDirectory, gaussian_data, read_splats};
use sgs_scene::Splats;
use std::path::Path;

/// Reads the Gaussians of a run or of a splat file; for a run also its settings.
pub fn splats_of(source: &Path) -> anyhow::Result<(Splats, Option<Settings>)> {
    if source.is_dir() {
        let run = RunDirectory::open(source)?;
        let ply = run.path("scene.ply");
        if !ply.is_file() {
            bail!("\"{}\" has no scene.ply yet: training was not finished; resume it with --resume.", source.display());
        }
        return Ok((Splats::read_ply(&ply)?, Some(run.settings()?)));
    }
    if !source.exists() {
        bail!("\"{}\" does not exist; give a run directory or a file of splats.", source.display());
    }
    Ok((read_splats(source)?, None))
}

/// Uploads splats to the device; semantic features only if `semantics` is set.
pub fn upload(device: &Device, splats: &Splats, semantics: bool) -> anyhow::Result<Gaussians> {
    let (sh_degree, normals) = (splats.sh_degree() as u32, splats.normals.is_some());
    let model = Model { sh_degree, normals, semantics, mip: splats.antialiased };
    let gaussians = Gaussians::new(device, model, splats.len() as u32, false).context("while loading the Gaussians")?;
    gaussians.upload(device, &gaussian_data(splats, model))?;
    Ok(gaussians)
}

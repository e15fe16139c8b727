//! Cameras of the pseudo-views for external rendering and segmentation: `sgs pseudo`.

use super::train::{Options, settings};
use crate::common::Common;
use crate::scenes::open_scene;
use sgs_scene::Camera;
use sgs_train::PseudoViews;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory.
    scene: PathBuf,
    /// Transforms file to write. Its cameras have the names of the masks in priors/masks/pseudo.
    #[arg(short, long, value_name = "FILE.json")]
    output: PathBuf,
    /// Options of the training. geometry.pseudo places the pseudo-views; views and scale matter, too.
    #[command(flatten)]
    options: Options,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let s = settings(&a.scene, &a.options)?;
    let pseudo = PseudoViews::new(&open_scene(&s)?, &s.geometry.pseudo)?;
    let cameras = pseudo.cameras();
    Camera::write_transforms(&a.output, &cameras)?;
    let (views, poses) = (pseudo.views(), pseudo.poses());
    let answer = serde_json::json!({"views": views, "poses": poses, "cameras": cameras.len(), "file": a.output});
    if !common.answer(&answer)? && !common.quiet {
        eprintln!("wrote {} cameras: 2 x {poses} for each of {views} training views", cameras.len());
    }
    Ok(())
}

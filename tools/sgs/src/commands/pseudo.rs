//! `sgs pseudo`: the cameras of the pseudo-views, to be rendered and segmented outside.

use super::train::open_scene;
use crate::common::Common;
use anyhow::bail;
use sgs_scene::Camera;
use sgs_train::{Neighbors, Position, PseudoOptions, PseudoViews, Settings};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory.
    scene: PathBuf,
    /// Transforms file to write; its cameras are called as the masks in priors/masks/pseudo.
    #[arg(short, long, value_name = "FILE.json")]
    output: PathBuf,
    /// Training views, spread evenly; all by default.
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Factor on the size of the images, at most 1.
    #[arg(long, value_name = "F")]
    scale: Option<f64>,
    /// Poses of each of the two sequences of a view, both ends among them.
    #[arg(long, value_name = "N", default_value_t = PseudoOptions::default().poses)]
    poses: u32,
    /// Where the second sequence comes from: the second-nearest training view, or the nearest test view.
    #[arg(long, value_enum, default_value = "training")]
    neighbors: Neighbor,
    /// How positions go from one pose to the next.
    #[arg(long, value_enum, default_value = "linear")]
    position: Path,
    /// Weight of the distance of positions, in units of the scene, when neighbors are chosen.
    #[arg(long, value_name = "F", default_value_t = PseudoOptions::default().lambda_t)]
    lambda_t: f64,
    /// Weight of the angle between orientations, in radians.
    #[arg(long, value_name = "F", default_value_t = PseudoOptions::default().lambda_r)]
    lambda_r: f64,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Neighbor {
    Training,
    Test,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Path {
    Linear,
    Cubic,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let options = PseudoOptions {
        poses: a.poses,
        lambda_t: a.lambda_t,
        lambda_r: a.lambda_r,
        neighbors: match a.neighbors {
            Neighbor::Training => Neighbors::Training,
            Neighbor::Test => Neighbors::Test,
        },
        position: match a.position {
            Path::Linear => Position::Linear,
            Path::Cubic => Position::Cubic,
        },
    };
    if a.views == Some(0) {
        bail!("--views is 0, but there must be at least one training view.");
    }
    let settings = Settings {
        scene: a.scene.clone(),
        views: a.views.unwrap_or(0),
        scale: a.scale.unwrap_or(1.0),
        ..Settings::default()
    };
    let scene = open_scene(&settings)?;
    let pseudo = PseudoViews::new(&scene, &options)?;
    let cameras = pseudo.cameras();
    Camera::write_transforms(&a.output, &cameras)?;
    let (views, poses) = (pseudo.views(), pseudo.poses());
    let answer = serde_json::json!({"views": views, "poses": poses, "cameras": cameras.len(), "file": a.output});
    if !common.answer(&answer)? && !common.quiet {
        eprintln!("wrote {} cameras: 2 x {poses} for each of {views} training views", cameras.len());
    }
    Ok(())
}

//! Quality of a scene's geometry at its test views after training with a choice.
//!
//! Metrics are always computed with exact settings.

use anyhow::Context;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_evaluate::evaluate;
use sgs_passes::scene::{Gaussians, Model};
use sgs_run::gaussian_data;
use sgs_scene::Scene;
use sgs_train::{Trainer, TrainerOptions};
use std::sync::Arc;

/// PSNR of images in dB, and error of normals in degrees if ground truth exists.
///
/// Measured at the training views if there are no test views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    pub psnr: f64,
    pub normals: Option<f64>,
}

/// Trains from the scene's points with a choice and measures the quality.
///
/// `semantics`: trains semantic features, too.
pub fn trained(
    device: &Device,
    scene: &Arc<Scene>,
    choice: &Settings,
    steps: u32,
    semantics: bool,
) -> anyhow::Result<Quality> {
    let mut settings = Settings { scene: scene.root.clone(), ..choice.clone() };
    (settings.geometry.steps, settings.geometry.semantics) = (steps, semantics);
    let mut trainer = Trainer::new(device, scene.clone(), &settings, TrainerOptions::default())?;
    trainer.run(&mut ())?;
    let splats = trainer.stage().context("nothing was trained")?.splats()?;
    drop(trainer);
    let (degree, normals) = (splats.sh_degree() as u32, splats.normals.is_some());
    let model = Model { sh_degree: degree, normals, semantics: false, mip: splats.antialiased };
    let gaussians = Gaussians::new(device, model, splats.len() as u32, false)?;
    gaussians.upload(device, &gaussian_data(&splats, model))?;
    let views = if scene.split.test.is_empty() { &scene.split.train } else { &scene.split.test };
    let mean = evaluate(device, scene, &gaussians, views, settings.geometry.background, |_, _| Ok(()))?.mean;
    Ok(Quality { psnr: mean.nvs.psnr, normals: mean.normal_mae_deg })
}

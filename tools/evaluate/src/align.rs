//! Alignment of views before they are measured.

use crate::error::Result;
use glam::DVec3;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Aligner, Step};
use sgs_passes::scene::{Gaussians, ViewKinds};
use sgs_run::{camera, pack_image};
use sgs_scene::{Camera, Image, Scene};

/// Steps of the alignment of a view.
const STEPS: u32 = 120;

/// Learning rates of the first step: radians, and logarithms of factors. Those of the last step are a hundredth.
const TURN: f64 = 1e-3;
const GAIN: f64 = 1e-2;

/// Camera and color factors with which Gaussians show a photograph best.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// Aligned camera.
    pub camera: Camera,
    /// Factors on the rendered red, green and blue.
    pub gains: [f32; 3],
}

/// Finder of alignments for the views of a scene.
pub struct Alignments {
    aligner: Aligner,
    extent: f64,
}

impl Alignments {
    /// Prepares for the views of a scene.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, gaussians: &Gaussians, scene: &Scene, kinds: ViewKinds) -> Result<Alignments> {
        let largest =
            scene.views.iter().fold([1, 1], |[w, h]: [u32; 2], v| [w.max(v.camera.width), h.max(v.camera.height)]);
        let aligner = Aligner::new(device, Tuning::for_device(device.info()), gaussians, largest, kinds)?;
        Ok(Alignments { aligner, extent: scene.extent() })
    }

    /// Aligns a view with its photograph.
    ///
    /// # Errors
    /// If the device fails.
    pub fn find(
        &mut self,
        gaussians: &Gaussians,
        view: &Camera,
        photograph: &Image,
        mask: Option<&Image>,
        background: [f32; 3],
    ) -> Result<Alignment> {
        let steps: Vec<Step> = (1..=STEPS)
            .map(|step| {
                let decay = 0.01_f64.powf(f64::from(step) / f64::from(STEPS));
                Step {
                    camera: camera(view),
                    background,
                    step,
                    sh_degree: gaussians.model.sh_degree,
                    weight_l1: 0.8,
                    weight_dssim: 0.2,
                    lr_turn: (TURN * decay) as f32,
                    lr_shift: (TURN * self.extent * decay) as f32,
                    lr_gain: (GAIN * decay) as f32,
                    ..Step::default()
                }
            })
            .collect();
        let found = self.aligner.align(gaussians, &pack_image(photograph, mask), &steps)?;
        let number = |i: usize| f64::from(found.values[i]);
        let (turn, shift) = (DVec3::new(number(0), number(1), number(2)), DVec3::new(number(3), number(4), number(5)));
        Ok(Alignment { camera: view.moved(turn, shift), gains: [6, 7, 8].map(|i| found.values[i].exp()) })
    }
}

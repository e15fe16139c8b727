//! Scenes.

use crate::border::Outcome;
use sgs_engine::Device;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::Channels;
use sgs_scene::Splats;
use std::sync::Mutex;

/// Gaussians on the device, with the renderer that renders them into memory.
pub struct SceneObject {
    pub gaussians: Gaussians,
    /// Renderer, with the channels that it renders.
    pub renderer: Mutex<Option<(Channels, Renderer)>>,
}

impl SceneObject {
    pub fn new(device: &Device, splats: &Splats) -> Outcome<SceneObject> {
        let (normals, mip) = (splats.normals.is_some(), splats.antialiased);
        let model = Model { sh_degree: splats.sh_degree() as u32, normals, mip, ..Default::default() };
        let gaussians = Gaussians::new(device, model, splats.len() as u32, false)?;
        gaussians.upload(device, &sgs_run::gaussian_data(splats, model))?;
        Ok(SceneObject { gaussians, renderer: Mutex::new(None) })
    }

    /// Returns the highest band for `bands`, which is the requested band plus one; 0 for all bands.
    pub fn degree(&self, bands: u32) -> u32 {
        let most = self.gaussians.model.sh_degree;
        if bands == 0 { most } else { (bands - 1).min(most) }
    }
}

//! Estimate of what the stage needs, before a room is fitted.

use super::in_room;
use crate::error::Result;
use crate::intrinsic::Intrinsic;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::pipeline::TransportShape;
use sgs_run::KnownEmitters;
use sgs_scene::{Scene, Splats};
use sgs_transport::planned_patches;

/// Number of emitters of the estimate, unless the scene names more.
const EMITTERS: u32 = 16;

/// Estimated needs of the transport stage.
pub struct TransportPlan {
    /// Training of materials and lights, with buffers for the largest room.
    pub training: Intrinsic,
    /// Sizes of that room.
    pub room: TransportShape,
}

impl TransportPlan {
    /// Plans the stage on splats.
    ///
    /// # Errors
    /// If data cannot be read or memory runs out.
    pub fn of(device: &Device, scene: &Scene, settings: &Settings, splats: &Splats) -> Result<TransportPlan> {
        let t = &settings.transport;
        let cameras: Vec<_> = scene.split.train.iter().map(|&i| scene.views[i].camera.clone()).collect();
        let patches = planned_patches(splats, &cameras)?;
        let known = KnownEmitters::of_scene(scene)?.map_or(0, |known| known.emitters.len() as u32);
        let room = TransportShape::largest(EMITTERS.max(known), t.surfels, patches, t.rays, splats.len() as u32);
        let training = Intrinsic::planned_in_room(device, scene, &in_room(settings), splats, room)?;
        Ok(TransportPlan { training, room })
    }
}

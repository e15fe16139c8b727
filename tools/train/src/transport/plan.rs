//! Estimate of what the stage needs, before a room is fitted.

use super::in_room;
use crate::error::Result;
use crate::intrinsic::Intrinsic;
use crate::memory::refuse_beyond;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::pipeline::TransportShape;
use sgs_run::KnownEmitters;
use sgs_scene::{Scene, Splats};
use sgs_transport::{FitNeeds, planned_patches};

/// Number of emitters of the estimate, unless the scene names more.
const EMITTERS: u32 = 16;

/// Estimated needs of the transport stage.
pub struct TransportPlan {
    /// Training of materials and lights, with buffers for the largest room.
    pub training: Intrinsic,
    /// Sizes of that room.
    pub room: TransportShape,
    /// Memory of the fit, which ends before the first step of training.
    pub fit: FitNeeds,
}

impl TransportPlan {
    /// Plans the stage on splats.
    ///
    /// # Errors
    /// If data cannot be read, memory runs out, or the stage exceeds the memory budget.
    pub fn of(device: &Device, scene: &Scene, settings: &Settings, splats: &Splats) -> Result<TransportPlan> {
        let t = &settings.transport;
        let cameras: Vec<_> = scene.split.train.iter().map(|&i| scene.views[i].camera.clone()).collect();
        let patches = planned_patches(splats, &cameras)?;
        let known = KnownEmitters::of_scene(scene)?.map_or(0, |known| known.emitters.len() as u32);
        let room = TransportShape::largest(EMITTERS.max(known), t.surfels, patches, t.rays, splats.len() as u32);
        if settings.memory.budget > 0 {
            device.set_memory_budget(Some(settings.memory.budget));
        }
        let fit = FitNeeds::of(device, scene, splats, &room)?;
        let advice = "use --scale, --views, a smaller transport.surfels, or a larger --memory-budget";
        refuse_beyond(&device.budget(), fit.peak(), &fit.parts(), "The fit of the room", advice)?;
        let training = Intrinsic::planned_in_room(device, scene, &in_room(settings), splats, room)?;
        Ok(TransportPlan { training, room, fit })
    }
}

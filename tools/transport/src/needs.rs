//! Device memory of the fit, before it runs.

use crate::error::Result;
use crate::explain::{BATCH, SAMPLES};
use crate::fitted::{cameras_of, reduced};
use crate::room::Room;
use serde::Serialize;
use sgs_engine::{Device, STAGING_BYTES};
use sgs_passes::pipeline::TransportShape;
use sgs_passes::transport::NEIGHBORS;
use sgs_scene::{Scene, Splats};

/// Bytes of device memory of a fit by purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FitNeeds {
    /// Shading of the training views, which ends before the room is built.
    pub shading: u64,
    /// Surfels, their tree, and the transport matrix.
    pub room: u64,
    /// Responses of receivers and samples to a batch of emitters, and points.
    pub light: u64,
    /// Staging memory of transfers.
    pub staging: u64,
}

impl FitNeeds {
    /// Measures the shading of the views, and sums the rest for a room of this size.
    ///
    /// Splats may lack materials and normals.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn of(device: &Device, scene: &Scene, splats: &Splats, room: &TransportShape) -> Result<FitNeeds> {
        let (count, cameras) = (splats.len(), cameras_of(&reduced(scene)));
        let mut shaded = splats.clone();
        shaded.albedo.get_or_insert_with(|| vec![[0.0; 3]; count]);
        shaded.roughness.get_or_insert_with(|| vec![0.0; count]);
        shaded.normals.get_or_insert_with(|| vec![[0.0, 0.0, 1.0]; count]);
        let (views, shading) = device.memory_during(|| Room::views(device, &shaded, &cameras));
        views?;
        let receivers = u64::from(room.matrix.receivers);
        let samples = |pixels: u64| pixels.min(SAMPLES as u64);
        let samples: u64 = cameras.iter().map(|c| samples(u64::from(c.width) * u64::from(c.height))).sum();
        let batch = BATCH as u64;
        // Points have 8 floats; a light has a record and a color.
        let lights = 76 * batch;
        let light = (4 * batch * receivers).max((4 * batch + 32) * samples) + lights;
        let largest = light.max(room.scene_bytes).max(4 * NEIGHBORS as u64 * count as u64);
        let staging = STAGING_BYTES.min(largest);
        Ok(FitNeeds { shading, room: room.scene_bytes + room.matrix.bytes(), light, staging })
    }

    /// Returns the peak memory: shading ends before the room is built.
    pub fn peak(&self) -> u64 {
        self.shading.max(self.room + self.light + self.staging)
    }

    /// Returns all entries with names and bytes.
    pub fn parts(&self) -> [(&'static str, u64); 4] {
        [
            ("shading of the views", self.shading),
            ("room", self.room),
            ("responses, receivers and samples", self.light),
            ("staging", self.staging),
        ]
    }
}

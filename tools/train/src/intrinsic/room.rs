//! Training in a room: its rates, and the correction of albedo priors.

use super::data::MaterialPriors;
use super::decisions;
use super::residue::{Pairs, SharedPriors, correct};
use super::surfaces::Surfaces;
use crate::data::TrainingData;
use crate::decision::Decision;
use crate::error::Result;
use sgs_engine::Device;
use sgs_passes::pipeline::TransportTraining;
use sgs_passes::scene::Gaussians;
use sgs_transport::TrainingRoom;

/// Learning rates in a room: of albedo, then of roughness and metallic.
///
/// Albedo has to follow its corrected priors; the others are trained already.
pub(super) const MATERIAL_RATES: [f32; 2] = [0.03, 0.002];
/// Weight of the loss that pulls the gains of light towards 1.
const GAIN_PULL: f32 = 0.05;
/// Learning rate of the logarithms of gains.
const GAINS_RATE: f32 = 0.01;
/// Learning rate of log colors of lights and of the enclosure's raw albedo.
///
/// Faster, colors take the part of the light that gains should stand for: windows that light little lose most of theirs.
const ROOM_RATE: f32 = 0.002;

/// Returns the options of training in a room.
///
/// Without albedo priors nothing tells gains of light from albedo, and they stay 1.
pub(super) fn training(room: &TrainingRoom, priors: bool) -> TransportTraining {
    TransportTraining {
        shape: *room.memory.shape(),
        gain_pull: priors.then_some(GAIN_PULL),
        gains_rate: GAINS_RATE,
        rate: ROOM_RATE,
    }
}

/// Training views whose albedo priors are corrected.
pub(super) struct PriorViews<'a> {
    pub device: &'a Device,
    pub gaussians: &'a Gaussians,
    pub data: &'a TrainingData,
    /// Packed photographs, by view.
    pub photographs: &'a [Vec<u32>],
}

/// Removes retained light and gains of views from albedo priors. Returns the decision that says how much.
pub(super) fn correct_priors(
    v: &PriorViews<'_>,
    surfaces: &mut Surfaces,
    albedo: &mut MaterialPriors,
) -> Result<Decision> {
    let (mut shared, mut pairs) = (SharedPriors::new(v.gaussians.capacity as usize), Pairs::default());
    for (i, (camera, _)) in v.data.views.iter().enumerate() {
        let surface = surfaces.of_view(v.gaussians, camera, i)?;
        shared.add(&surface.weights(v.device)?, &albedo.packed[i]);
        let [_, normals, _] = surface.download(v.device)?;
        let size = camera.size.map(|side| side as usize);
        pairs.add(size, &normals, [&albedo.packed[i], &v.photographs[i]], v.data.views.len());
    }
    let (residue, log_gains) = (pairs.residue(), shared.log_gains());
    correct(&mut albedo.packed, v.photographs, &log_gains, residue);
    Ok(decisions::corrected_priors(residue, &log_gains))
}

//! Training in a room: its start, its rates, and the correction of albedo priors.

use super::Intrinsic;
use super::data::MaterialPriors;
use super::decisions;
use super::prepare::Purpose;
use super::residue::{Pairs, SharedPriors, correct, equalize, linear, plain};
use super::start::albedo_of_colors;
use super::surfaces::Surfaces;
use crate::data::TrainingData;
use crate::decision::Decision;
use crate::error::Result;
use sgs_config::{MaterialStart, Settings};
use sgs_engine::Device;
use sgs_passes::pipeline::{TransportMemory, TransportShape, TransportTrainables, TransportTraining};
use sgs_passes::scene::{Gaussians, Trainable};
use sgs_scene::{Scene, Splats};
use sgs_transport::TrainingRoom;

/// Learning rate of albedo, and of materials with priors.
const MATERIAL_RATE: f32 = 0.03;
/// Learning rate of roughness and metallic without priors.
const SLOW_RATE: f32 = 0.002;
/// Weight of the loss that pulls the gains of light towards 1.
const GAIN_PULL: f32 = 0.05;
/// Learning rate of the logarithms of gains.
const GAINS_RATE: f32 = 0.01;
/// Learning rate of log colors of lights and of the enclosure's raw albedo.
///
/// Faster, colors take the part of the light that gains should stand for: windows that light little lose most of theirs.
const ROOM_RATE: f32 = 0.002;

/// Returns the learning rates of albedo, roughness and metallic. The arguments say whether they have priors.
pub(super) fn material_rates(roughness: bool, metallic: bool) -> [f32; 3] {
    let of = |prior: bool| if prior { MATERIAL_RATE } else { SLOW_RATE };
    [MATERIAL_RATE, of(roughness), of(metallic)]
}

/// Returns the options of training in a room.
///
/// Without albedo priors nothing tells gains of light from albedo, and they stay 1.
pub(super) fn training(shape: TransportShape, priors: bool) -> TransportTraining {
    TransportTraining { shape, gain_pull: priors.then_some(GAIN_PULL), gains_rate: GAINS_RATE, rate: ROOM_RATE }
}

/// Allocates the trained parameters of a room, or of one that is only planned.
pub(super) fn trainables(
    device: &Device,
    room: Option<&TrainingRoom>,
    planned: Option<&TransportMemory>,
    gaussians: usize,
) -> Result<Option<TransportTrainables>> {
    let blank = |memory: &TransportMemory| (vec![0.0; 3 * memory.shape().lights as usize], vec![0.0; 18]);
    let given = |room: &TrainingRoom| (room.log_colors.clone(), room.enclosure.clone());
    let Some((log_colors, enclosure)) = room.map(given).or_else(|| planned.map(blank)) else { return Ok(None) };
    Ok(Some(TransportTrainables {
        log_colors: Trainable::new(device, "light_log_colors", &log_colors, true)?,
        enclosure: Trainable::new(device, "enclosure_albedo", &enclosure, true)?,
        log_gains: Trainable::new(device, "log_gains", &vec![0.0; gaussians], true)?,
    }))
}

/// Training views whose priors are corrected.
pub(super) struct PriorViews<'a> {
    pub device: &'a Device,
    pub gaussians: &'a Gaussians,
    pub data: &'a TrainingData,
}

/// Removes retained light and gains of views from albedo priors. Returns the decision that says how much.
///
/// `photographs` are packed, by view.
pub(super) fn correct_priors(
    v: &PriorViews<'_>,
    photographs: &[Vec<u32>],
    surfaces: &mut Surfaces,
    albedo: &mut MaterialPriors,
) -> Result<Decision> {
    let (mut shared, mut pairs) = (SharedPriors::new(v.gaussians.capacity as usize, linear), Pairs::default());
    for (i, (camera, _)) in v.data.views.iter().enumerate() {
        let surface = surfaces.of_view(v.gaussians, camera, i)?;
        shared.add(&surface.weights(v.device)?, &albedo.packed[i]);
        let [_, normals, _] = surface.download(v.device)?;
        let size = camera.size.map(|side| side as usize);
        pairs.add(size, &normals, [&albedo.packed[i], &photographs[i]], v.data.views.len());
    }
    let (residue, log_gains) = (pairs.residue(), shared.log_gains());
    correct(&mut albedo.packed, photographs, &log_gains, residue);
    Ok(decisions::corrected_priors(residue, &log_gains))
}

/// Removes gains of views from roughness priors. Returns the decision that says how much.
pub(super) fn equalize_priors(
    v: &PriorViews<'_>,
    surfaces: &mut Surfaces,
    roughness: &mut MaterialPriors,
) -> Result<Decision> {
    let mut shared = SharedPriors::new(v.gaussians.capacity as usize, plain);
    for (i, (camera, _)) in v.data.views.iter().enumerate() {
        shared.add(&surfaces.of_view(v.gaussians, camera, i)?.weights(v.device)?, &roughness.packed[i]);
    }
    let log_gains = shared.log_gains();
    equalize(&mut roughness.packed, &log_gains);
    Ok(decisions::equal_priors(&log_gains))
}

impl Intrinsic {
    /// Returns splats with the materials from which training starts, and normals.
    ///
    /// Materials start from their priors. Albedo without priors starts from the splats' colors, roughness and metallic
    /// from those of the splats. If the settings start gray, those of the splats come before gray.
    ///
    /// # Errors
    /// As [`Intrinsic::new`].
    pub(crate) fn starting_materials(
        device: &Device,
        scene: &Scene,
        settings: &Settings,
        splats: &Splats,
    ) -> Result<Splats> {
        let bare = Splats { albedo: None, roughness: None, metallic: None, ..splats.clone() };
        let planned = Intrinsic::planned(device, scene, settings, &bare)?;
        let (priors, start) = (planned.priors(), planned.splats()?);
        let uses_priors = settings.intrinsic.start == MaterialStart::Priors;
        // The splats' own materials, where no prior replaces them.
        fn own<T: Clone>(prior: bool, own: &Option<T>) -> Option<T> {
            own.clone().filter(|_| !prior)
        }
        let guessed = (uses_priors && !priors.albedo).then(|| albedo_of_colors(splats));
        Ok(Splats {
            albedo: guessed.or(own(uses_priors, &splats.albedo)).or(start.albedo),
            roughness: own(uses_priors && priors.roughness, &splats.roughness).or(start.roughness),
            metallic: own(uses_priors && priors.metallic, &splats.metallic).or(start.metallic),
            normals: splats.normals.clone().filter(|_| !lacks_normals(splats)).or(start.normals),
            ..splats.clone()
        })
    }

    /// Prepares training under the physical lights of a room.
    ///
    /// The settings have no point lights and no environment map.
    ///
    /// # Errors
    /// As [`Intrinsic::new`].
    pub(crate) fn in_room(
        device: &Device,
        scene: &Scene,
        settings: &Settings,
        splats: &Splats,
        room: TrainingRoom,
    ) -> Result<Intrinsic> {
        Intrinsic::of(device, scene, settings, splats, Purpose::InRoom(Box::new(room)))
    }

    /// Plans a training under the physical lights of a room of these sizes.
    ///
    /// # Errors
    /// As [`Intrinsic::new`].
    pub(crate) fn planned_in_room(
        device: &Device,
        scene: &Scene,
        settings: &Settings,
        splats: &Splats,
        shape: TransportShape,
    ) -> Result<Intrinsic> {
        Intrinsic::of(device, scene, settings, splats, Purpose::PlanningRoom(shape))
    }
}

/// Returns whether splats have no normals.
pub(super) fn lacks_normals(splats: &Splats) -> bool {
    splats.normals.as_ref().is_none_or(|n| n.iter().all(|n| *n == [0.0; 3]))
}

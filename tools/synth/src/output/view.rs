//! Files of one view.

use glam::Vec3;

use crate::error::SynthError;
use crate::output::layout::Names;
use crate::output::stage::Stage;
use crate::output::{exr, npy, png};
use crate::priors::maps::Maps;
use crate::priors::semantic::{DIM, Features};
use crate::trace::film::{Feature, Film};

/// Writes the ground truth. Reflectance is averaged over pixels; geometry and ids hold at pixel centers.
pub(crate) fn truth(stage: &Stage, names: &Names, film: &Film) -> Result<(), SynthError> {
    let (w, h, stem) = (film.width, film.height, names.stem());
    let file = |kind: &str, extension: &str| stage.file(format!("gt/{kind}/{stem}.{extension}"));
    let features = |f: fn(&Feature) -> u8| film.features.iter().map(f).collect::<Vec<_>>();
    let depth: Vec<f32> = film.features.iter().map(|f| f.depth).collect();
    let metallic: Vec<f32> = film.pixels.iter().map(|p| p.metallic).collect();
    names.albedo(stage, film)?;
    names.normal(stage, film)?;
    names.roughness(stage, film)?;
    exr::single(&file("depth", "exr")?, w, h, &depth)?;
    exr::half(&file("metallic", "exr")?, w, h, &metallic)?;
    png::bytes(&file("mask", "png")?, w, h, &features(|f| if f.surface { 255 } else { 0 }))?;
    png::bytes(&file("semantic", "png")?, w, h, &features(|f| f.class as u8))
}

/// Writes the simulated priors other than semantic features.
pub(crate) fn priors(stage: &Stage, stem: &str, film: &Film, maps: &Maps, masks: &[u16]) -> Result<(), SynthError> {
    let (w, h) = (film.width, film.height);
    let file = |kind: &str| stage.file(format!("priors/{kind}/{stem}.png"));
    let normal: Vec<Vec3> = maps.normal.iter().map(|n| 0.5 * *n + Vec3::splat(0.5)).collect();
    png::rgb(&file("normal")?, w, h, &normal)?;
    png::rgb(&file("albedo")?, w, h, &maps.albedo)?;
    png::gray(&file("roughness")?, w, h, &maps.roughness)?;
    png::gray(&file("metallic")?, w, h, &maps.metallic)?;
    png::words(&file("masks")?, w, h, masks)
}

/// Writes semantic features.
pub(crate) fn semantic(stage: &Stage, stem: &str, features: &Features) -> Result<(), SynthError> {
    let bytes: Vec<u8> = features.values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let shape = [features.height, features.width, DIM];
    stage.write(format!("priors/semantic/{stem}.npy"), &npy::encode("<f2", &shape, &bytes))
}

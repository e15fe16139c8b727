//! The files of one view.

use glam::Vec3;

use crate::color::encode3;
use crate::error::SynthError;
use crate::output::stage::Stage;
use crate::output::{exr, npy, png};
use crate::priors::maps::Maps;
use crate::priors::semantic::{DIM, Features};
use crate::trace::denoise::Image;
use crate::trace::film::{Feature, Film, Pixel};

/// Writes the picture.
pub(crate) fn image(stage: &Stage, stem: &str, film: &Film, image: &Image) -> Result<(), SynthError> {
    let display: Vec<Vec3> = image.iter().map(|c| encode3(*c)).collect();
    let path = stage.file(format!("images/{stem}.png"))?;
    png::rgb(&path, film.width, film.height, &display)
}

/// Writes the view under another lighting.
pub(crate) fn relit(stage: &Stage, stem: &str, name: &str, film: &Film, image: &Image) -> Result<(), SynthError> {
    let path = stage.file(format!("gt/relit/{name}/{stem}.exr"))?;
    exr::rgb(&path, film.width, film.height, image)
}

/// Writes the ground truth: reflectance as averaged over pixels, geometry and ids at pixel centers.
pub(crate) fn truth(stage: &Stage, stem: &str, film: &Film) -> Result<(), SynthError> {
    let (w, h) = (film.width, film.height);
    let file = |kind: &str, extension: &str| stage.file(format!("gt/{kind}/{stem}.{extension}"));
    let pixels = |f: fn(&Pixel) -> f32| film.pixels.iter().map(f).collect::<Vec<_>>();
    let features = |f: fn(&Feature) -> u8| film.features.iter().map(f).collect::<Vec<_>>();
    let albedo: Vec<Vec3> = film.pixels.iter().map(|p| p.albedo).collect();
    let normal: Vec<Vec3> = film.features.iter().map(|f| f.normal).collect();
    let depth: Vec<f32> = film.features.iter().map(|f| f.depth).collect();
    exr::rgb(&file("albedo", "exr")?, w, h, &albedo)?;
    exr::rgb(&file("normal", "exr")?, w, h, &normal)?;
    exr::single(&file("depth", "exr")?, w, h, &depth)?;
    exr::half(&file("roughness", "exr")?, w, h, &pixels(|p| p.roughness))?;
    exr::half(&file("metallic", "exr")?, w, h, &pixels(|p| p.metallic))?;
    png::bytes(&file("mask", "png")?, w, h, &features(|f| if f.surface { 255 } else { 0 }))?;
    png::bytes(&file("semantic", "png")?, w, h, &features(|f| f.class as u8))
}

/// Writes the imitated priors other than semantic features.
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

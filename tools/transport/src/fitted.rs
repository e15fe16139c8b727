//! Emitters and enclosure of a scene, as a run stores them.

use crate::error::Result;
use crate::explain::Explained;
use crate::room::{Room, RoomOptions};
use crate::training::TrainingRoom;
use sgs_config::{TransportPart, TransportSettings};
use sgs_engine::Device;
use sgs_passes::transport::{AreaLight, LightShape};
use sgs_run::{EmitterFile, EmitterRow, EnclosureRow, KnownEmitters, MOST_OPENINGS, OpeningRow};
use sgs_scene::{Camera, Image, Scene, Splats};

/// Emitters and enclosure of a room.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedRoom {
    /// Emitters and enclosure, in world units.
    pub emitters: EmitterFile,
    /// Emitter of each Gaussian: 0 emits nothing, `i + 1` belongs to emitter `i`.
    pub of_gaussians: Vec<u32>,
    /// PSNR of the compared pixels of the training views, in dB.
    pub psnr: f64,
    /// PSNR of the same pixels under the best uniform light, in dB.
    pub uniform_psnr: f64,
}

/// Maximum number of pixels of all training views together.
///
/// All of them are in memory at once.
const MOST_PIXELS: f64 = 2_097_152.0;

/// Returns the cameras of the training views.
pub(crate) fn cameras_of(scene: &Scene) -> Vec<Camera> {
    scene.split.train.iter().map(|&i| scene.views[i].camera.clone()).collect()
}

/// Returns the scene, with smaller images if there are too many pixels.
pub(crate) fn reduced(scene: &Scene) -> Scene {
    let pixels = |camera: &Camera| f64::from(camera.width) * f64::from(camera.height);
    let all: f64 = scene.split.train.iter().map(|&i| pixels(&scene.views[i].camera)).sum();
    if all <= MOST_PIXELS { scene.clone() } else { scene.scaled((MOST_PIXELS / all).sqrt()) }
}

/// Finds the emitters of a scene and fits them to its training images.
///
/// Their colors, the positions of spheres and the albedo of the enclosure are fitted. Rectangles are openings, too. If the
/// scene names its emitters ([`KnownEmitters`]), none is searched: their colors and the albedo of the enclosure are fitted.
/// Lengths of the scene, the splats and the result are in the scene's unit.
///
/// # Errors
/// If the splats have no materials, a photograph or the file of emitters cannot be used, or the device fails.
pub fn fit_room(device: &Device, scene: &Scene, splats: &Splats, options: RoomOptions) -> Result<FittedRoom> {
    let known = KnownEmitters::of_scene(scene)?;
    let scene = reduced(scene);
    let cameras = cameras_of(&scene);
    let photographs: Vec<Image> = scene.load_train_images()?;
    let (room, mut views) = Room::new(device, splats, &cameras, options)?;
    for (view, &i) in scene.split.train.iter().enumerate() {
        if let Some(mask) = scene.load_mask(i)? {
            views.exclude(view, &mask);
        }
    }
    let (room, shapes) = match &known {
        Some(known) => {
            let shapes: Vec<LightShape> = known.emitters.iter().map(|e| e.shape).collect();
            (room.with_outside(&known.openings, None)?, Some(shapes))
        }
        None => (room, None),
    };
    let explained = room.explain(&views, &photographs, splats, shapes.as_deref())?;
    let [low, high] = room.bounds();

    let enclosure = EnclosureRow { low, high, albedo: explained.enclosure };
    let RoomOptions { surfels, rays, without, .. } = options;
    let settings = TransportSettings { surfels: surfels as u32, rays, without, ..TransportSettings::default() };
    let Explained { emitters, mut of_gaussians, psnr, uniform_psnr, .. } = explained;
    if without == Some(TransportPart::Emission) {
        of_gaussians.fill(0);
    }
    let openings = match &known {
        Some(known) => known.openings.clone(),
        None => emitters.iter().filter_map(|e| OpeningRow::of(&e.shape)).take(MOST_OPENINGS).collect(),
    };
    let rows = match known {
        Some(known) => {
            let fitted = known.emitters.into_iter().zip(&emitters);
            fitted.map(|(row, light)| EmitterRow { color: light.color, ..row }).collect()
        }
        None => named(&emitters),
    };
    let emitters = EmitterFile { openings, ..EmitterFile::new(enclosure, settings, rows) };
    Ok(FittedRoom { emitters, of_gaussians, psnr, uniform_psnr })
}

/// Names emitters by their shape: rectangles are windows, others are lights.
fn named(emitters: &[AreaLight]) -> Vec<EmitterRow> {
    let mut counts = [0; 2];
    let row = |light: &AreaLight| {
        let (kind, count) = match light.shape {
            LightShape::Rectangle { .. } => ("window", &mut counts[0]),
            _ => ("light", &mut counts[1]),
        };
        *count += 1;
        EmitterRow { name: format!("{kind} {count}"), on: true, color: light.color, shape: light.shape }
    };
    emitters.iter().map(row).collect()
}

/// Builds the room of a run with emitters.
///
/// Surfels are those that the training views of the scene show of `splats`. The openings and the albedo of the enclosure are those
/// of `emitters`.
/// `seed` is that of rays and sample points.
///
/// # Errors
/// If the splats have no materials, or the device fails.
pub fn room_of(device: &Device, scene: &Scene, splats: &Splats, emitters: &EmitterFile, seed: u32) -> Result<Room> {
    let EmitterFile { surfels, rays, without, .. } = *emitters;
    let options = RoomOptions { surfels: surfels as usize, rays, seed, without, ..RoomOptions::default() };
    let (room, _) = Room::new(device, splats, &cameras_of(&reduced(scene)), options)?;
    room.with_enclosure(emitters.enclosure.albedo).with_outside(&emitters.openings, None)
}

/// Prepares the training of materials and lights in a fitted room.
///
/// Lengths of the scene and the splats are in the scene's unit.
///
/// # Errors
/// If the splats have no materials, or the device fails.
pub fn training_room(
    device: &Device,
    scene: &Scene,
    splats: &Splats,
    fitted: &FittedRoom,
    seed: u32,
) -> Result<TrainingRoom> {
    let lights = fitted.emitters.lights();
    let plain = Splats { light_gains: None, ..splats.clone() };
    let room = room_of(device, scene, &plain, &fitted.emitters, seed)?;
    let of = |number: &u32| match *number {
        0 => [0.0; 3],
        number => lights.get(number as usize - 1).map_or([0.0; 3], |light| light.color),
    };
    let emission: Vec<[f32; 3]> = fitted.of_gaussians.iter().map(of).collect();
    room.training(&plain, &lights, &emission)
}

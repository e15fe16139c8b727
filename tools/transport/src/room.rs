//! Room: surfels, enclosure and transport matrix of trained Gaussians.
//!
//! Cells are those into which surfels are clustered ([`crate::surfels`]).

use crate::error::{Result, TransportError};
use crate::radiosity::FACES;
use crate::surfels::{RoomSurfels, SurfelMaterial, SurfelOptions};
use crate::views::SeenViews;
use glam::Vec3;
use sgs_config::TransportPart;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{FrameEmitter, Responder, Shaded, ShadedTransport, TransportOptions, TransportScene};
use sgs_passes::transport::{
    AreaLight, Enclosure, Nearest, NearestOptions, Opening, Outside, Sky, SolveOptions, SurfelTree, nearest_surfels,
    parts_of,
};
use sgs_run::{OpeningRow, Shading, Visibility, shaded_scene};
use sgs_scene::{Camera, Splats, Unit};
use std::f32::consts::PI;
use std::sync::Arc;

/// Distance above a surface at which rays begin, in edges of a cell.
const OFFSET: f32 = 0.4;
/// Distance before a light at which shadow rays end, in edges of a cell.
///
/// Reconstructed surfaces of emitters often lie in front of the true ones, and must not hide the light.
const CLEARANCE: f32 = 3.0;
/// Edge of a patch of the enclosure, as a share of the diagonal of the room.
const PATCH_SHARE: f32 = 0.04;
/// Distance of the enclosure from the surfaces in it, as a share of the diagonal.
const MARGIN: f32 = 0.005;
/// Distance that a difference of normals of length 1 counts as.
///
/// As a share of the diagonal: 0.25 m in a room of 10 m.
const NORMAL_SHARE: f32 = 0.025;
/// Hemispherical reflectance of a patch's specular lobe, added to its albedo.
pub(crate) const SHEEN: f64 = 0.03;

/// Options of a [`Room`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoomOptions {
    /// Maximum number of surfels.
    pub surfels: usize,
    /// Rays per surfel and patch.
    pub rays: u32,
    /// Sample points of a light with an extent, to each of which a shadow ray goes.
    pub samples: u32,
    /// Seed of rays and sample points.
    pub seed: u32,
    /// Part that is left out, if any.
    pub without: Option<TransportPart>,
}

impl Default for RoomOptions {
    fn default() -> RoomOptions {
        RoomOptions { surfels: 8192, rays: 64, samples: 8, seed: 0, without: None }
    }
}

/// Number of bounces of light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bounces {
    /// Direct light only.
    None,
    /// One bounce.
    One,
    /// Bounces until the largest relative change is less than a thousandth.
    All,
}

/// Direct light of a room. Lengths are in the unit of the surfels.
pub struct LitRoom<'a> {
    /// Transport matrix. Receivers are surfels, then patches of the enclosure.
    pub scene: &'a TransportScene,
    /// Surfels.
    pub surfels: &'a RoomSurfels,
    /// Box whose patches close the room.
    pub enclosure: &'a Enclosure,
    /// Lights.
    pub lights: &'a [AreaLight],
    /// Reflectance of the receivers, `[receivers * 3]`.
    pub reflectance: Vec<f32>,
    /// Radiosity without bounces, as a radiance, `[receivers * 3]`.
    pub source: Vec<f32>,
}

/// Light that bounces in a room.
struct Bounced {
    /// Irradiance of the receivers, `[receivers * 3]`.
    irradiance: Vec<f32>,
    /// Radiosity that pixels reflect, as a radiance, `[receivers * 3]`; without it, lobes reflect the irradiance.
    radiosity: Option<Vec<f32>>,
}

/// Surfaces of a room that exchange light.
#[derive(Clone)]
pub struct Room {
    device: Device,
    /// Unit of all lengths on the device.
    pub(crate) unit: Unit,
    pub(crate) surfels: RoomSurfels,
    pub(crate) enclosure: Enclosure,
    pub(crate) scene: Arc<TransportScene>,
    /// Nearest surfels of each Gaussian.
    nearest: Nearest,
    /// Albedo of each face of the enclosure.
    albedo: [[f32; 3]; FACES],
    /// Logarithm of each Gaussian's gain on the light that arrives, if they have any.
    log_gains: Option<Vec<f32>>,
}

impl Room {
    /// Builds the room that the cameras see, and shades its views.
    ///
    /// The Gaussians need materials and normals. The albedo of the enclosure is the mean albedo of the surfels
    /// ([`Room::with_enclosure`] sets another).
    ///
    /// # Errors
    /// If the Gaussians have no materials or no camera sees a surface, or if the device fails.
    pub fn new(
        device: &Device,
        splats: &Splats,
        cameras: &[Camera],
        options: RoomOptions,
    ) -> Result<(Room, SeenViews)> {
        let unit = Unit::of_splats(splats);
        let views = Room::views(device, splats, cameras)?;
        let from: Vec<[f32; 3]> = cameras.iter().map(|c| c.position().as_vec3().to_array()).collect();
        let length = unit.length() as f32;
        let surfels = RoomSurfels::cluster(&views, &from, length, SurfelOptions { most: options.surfels });
        if surfels.is_empty() {
            return Err(TransportError::Empty);
        }
        let (mut low, mut high) = (Vec3::from(surfels.bounds[0]), Vec3::from(surfels.bounds[1]));
        for place in &from {
            let place = Vec3::from(unit.place(*place));
            (low, high) = (low.min(place), high.max(place));
        }
        let diagonal = low.distance(high);
        (low, high) = (low - MARGIN * diagonal, high + MARGIN * diagonal);
        let enclosure = Enclosure::new(low.into(), high.into(), PATCH_SHARE * diagonal)?;
        let tree = SurfelTree::new(&surfels.discs)?;
        let transport = TransportOptions {
            rays: options.rays,
            samples: options.samples,
            seed: options.seed,
            offset: OFFSET * surfels.cell,
            clearance: CLEARANCE * surfels.cell,
        };
        let tuning = Tuning::for_device(device.info());
        let scene = TransportScene::new(device, tuning, (&surfels.discs, &tree), &enclosure, transport)?;
        let scene = match options.without {
            Some(TransportPart::Bounces) => scene.lit_by_first(0)?,
            Some(TransportPart::Enclosure) => scene.lit_by_first(surfels.len() as u32)?,
            _ => scene,
        };
        let near = near(diagonal, surfels.cell);
        let places: Vec<[f32; 3]> = splats.means.iter().map(|mean| unit.place(*mean)).collect();
        let length_one = |n: &[f32; 3]| Vec3::from(*n).normalize_or_zero().to_array();
        let normals: Vec<[f32; 3]> = splats.normals.iter().flatten().map(length_one).collect();
        let nearest = nearest_surfels(&places, &normals, &surfels.discs, &near);
        let mean = surfels.mean_albedo();
        let room = Room {
            device: device.clone(),
            unit,
            surfels,
            enclosure,
            scene: Arc::new(scene),
            nearest,
            albedo: [mean; FACES],
            log_gains: splats.light_gains.as_ref().map(|gains| gains.iter().map(|g| g.ln()).collect()),
        };
        Ok((room, SeenViews::new(views, cameras)))
    }

    /// Shades the views without light.
    pub(crate) fn views(device: &Device, splats: &Splats, cameras: &[Camera]) -> Result<Vec<Shaded>> {
        let plain = shaded_scene(device, splats, None, None, &Visibility::None)?;
        let mut shading = Shading::new(device, plain)?.without_visibility();
        cameras.iter().map(|camera| Ok(shading.shade(camera)?.0)).collect()
    }

    /// Sets the albedo of the faces of the enclosure: low x, high x, low y, high y, low z, high z.
    #[must_use]
    pub fn with_enclosure(mut self, albedo: [[f32; 3]; FACES]) -> Room {
        self.albedo = albedo;
        self
    }

    /// Sets the openings, in world units, and the environment behind them.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_outside(mut self, openings: &[OpeningRow], sky: Option<&Sky>) -> Result<Room> {
        let by = (1.0 / self.unit.length()) as f32;
        let openings = openings.iter().map(|o| Opening::from(*o).scaled(by)).collect();
        self.scene = Arc::new((*self.scene).clone().with_outside(&Outside { openings, sky: sky.cloned() })?);
        Ok(self)
    }

    /// Returns the corners of the enclosure in world units.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        [self.enclosure.low(), self.enclosure.high()].map(|corner| self.unit.inverse().place(corner))
    }

    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the nearest surfels of each Gaussian.
    pub(crate) fn nearest(&self) -> &Nearest {
        &self.nearest
    }

    /// Returns the albedo of each face of the enclosure.
    pub(crate) fn albedo(&self) -> &[[f32; 3]; FACES] {
        &self.albedo
    }

    /// Returns the diagonal of the enclosure in the room's unit.
    pub(crate) fn diagonal(&self) -> f32 {
        Vec3::from(self.enclosure.low()).distance(self.enclosure.high().into())
    }

    /// Returns the number of surfels.
    pub fn surfels(&self) -> usize {
        self.surfels.len()
    }

    /// Returns what shading the room's Gaussians under lights needs.
    ///
    /// Lights are in world units. `emission` holds the radiance that each Gaussian emits. It is visible, but does not light the
    /// room.
    ///
    /// # Errors
    /// If a light is invalid or the device fails.
    pub fn light(&self, lights: &[AreaLight], emission: &[[f32; 3]], bounces: Bounces) -> Result<ShadedTransport> {
        self.light_with(lights, emission, |lit| match bounces {
            Bounces::None => Ok(Bounced { irradiance: vec![0.0; lit.source.len()], radiosity: None }),
            // The first Jacobi iteration gathers the radiosity of direct light: light after one bounce.
            Bounces::One => {
                let options = SolveOptions { iterations: 1, accelerated: false, ..Default::default() };
                let irradiance = lit.scene.solve(&lit.reflectance, &lit.source, &options)?;
                Ok(Bounced { irradiance, radiosity: Some(lit.source.clone()) })
            }
            Bounces::All => {
                let irradiance = lit.scene.solve(&lit.reflectance, &lit.source, &SolveOptions::default())?;
                let reflected = lit.reflectance.iter().zip(&irradiance).map(|(rho, e)| rho / PI * e);
                let radiosity = lit.source.iter().zip(reflected).map(|(source, r)| source + r).collect();
                Ok(Bounced { irradiance, radiosity: Some(radiosity) })
            }
        })
    }

    /// Returns the same with bounces by a function.
    ///
    /// `bounced` returns the irradiance that bounces, `[receivers * 3]`. Gaussians gather that of the surfels, and specular
    /// lobes reflect it.
    ///
    /// # Errors
    /// If a light is invalid, `bounced` fails, or the device fails.
    pub fn light_by(
        &self,
        lights: &[AreaLight],
        emission: &[[f32; 3]],
        bounced: impl FnOnce(&LitRoom<'_>) -> Result<Vec<f32>>,
    ) -> Result<ShadedTransport> {
        self.light_with(lights, emission, |lit| Ok(Bounced { irradiance: bounced(lit)?, radiosity: None }))
    }

    fn light_with(
        &self,
        lights: &[AreaLight],
        emission: &[[f32; 3]],
        bounced: impl FnOnce(&LitRoom<'_>) -> Result<Bounced>,
    ) -> Result<ShadedTransport> {
        let lights = self.scaled(lights)?;
        let count = self.scene.receivers() as usize;
        let unit = self.scene.unit_light(&lights)?;
        let reflectance = self.reflectance();
        let mut source = vec![0.0; 3 * count];
        for (light, unit) in parts_of(&lights).iter().zip(unit.chunks_exact(count)) {
            for (i, e) in unit.iter().enumerate() {
                for c in 0..3 {
                    source[3 * i + c] += light.color[c] * e * reflectance[3 * i + c] / PI;
                }
            }
        }
        let (scene, surfels, enclosure) = (&*self.scene, &self.surfels, &self.enclosure);
        let lit = LitRoom { scene, surfels, enclosure, lights: &lights, reflectance, source };
        let Bounced { irradiance, radiosity } = bounced(&lit)?;
        let (device, scene) = (&self.device, Arc::clone(&self.scene));
        let mut shaded = ShadedTransport::new(device, scene, &lights, &self.nearest, &irradiance, emission)?;
        if let Some(radiosity) = radiosity {
            shaded = shaded.with_radiosity(device, &radiosity)?;
        }
        self.with_gains(shaded)
    }

    /// Returns what shading under emitters of changing color needs.
    ///
    /// Traces the shadow rays and solves the bounces of each emitter once. `numbers` holds the emitter of each Gaussian,
    /// from 1, or 0. Emitters are in world units.
    ///
    /// # Errors
    /// If a light is invalid or the device fails.
    pub fn respond(&self, emitters: &[FrameEmitter], numbers: &[u32]) -> Result<ShadedTransport> {
        let lights: Vec<AreaLight> = emitters.iter().map(|e| e.light).collect();
        let lights = self.scaled(&lights)?;
        let unit = self.scene.unit_light(&lights)?;
        let reflectance = self.reflectance();
        let responses = self.scene.responses(&reflectance, &unit, &SolveOptions::default())?;
        let place = |(light, e): (&AreaLight, &FrameEmitter)| FrameEmitter { light: *light, ..*e };
        let scaled: Vec<FrameEmitter> = lights.iter().zip(emitters).map(place).collect();
        let (device, scene) = (&self.device, Arc::clone(&self.scene));
        let shaded = ShadedTransport::with_responses(device, scene, &scaled, &self.nearest, &responses, numbers)?;
        self.with_gains(shaded.with_direct_light(device, &unit, &reflectance)?)
    }

    /// Adds the gains of the Gaussians, if they have any.
    fn with_gains(&self, shaded: ShadedTransport) -> Result<ShadedTransport> {
        Ok(match &self.log_gains {
            Some(log_gains) => shaded.with_gains(&self.device, log_gains)?,
            None => shaded,
        })
    }

    /// Prepares the update of single responses of [`Room::respond`].
    ///
    /// # Errors
    /// If memory runs out.
    pub fn responder(&self, transport: &ShadedTransport) -> Result<Responder> {
        let tuning = Tuning::for_device(self.device.info());
        Ok(Responder::new(&self.device, tuning, transport, &self.reflectance())?)
    }

    /// Converts a light to the unit of the device.
    pub fn in_unit(&self, light: &AreaLight) -> AreaLight {
        light.scaled((1.0 / self.unit.length()) as f32)
    }

    /// Converts lights to the unit of the device, and checks them.
    pub(crate) fn scaled(&self, lights: &[AreaLight]) -> Result<Vec<AreaLight>> {
        let by = (1.0 / self.unit.length()) as f32;
        lights
            .iter()
            .map(|light| {
                light.check()?;
                Ok(light.scaled(by))
            })
            .collect()
    }

    /// Returns the reflectance of all receivers, `[receivers * 3]`.
    fn reflectance(&self) -> Vec<f32> {
        let patches = self.enclosure.patches();
        let of_patches = patches.iter().flat_map(|p| self.albedo[p.face as usize].map(|a| (a + SHEEN as f32).min(1.0)));
        self.surfels.materials.iter().flat_map(reflectance).chain(of_patches).collect()
    }
}

/// Returns the number of patches of the enclosure around splats and cameras.
///
/// # Errors
/// If a position is not finite.
pub fn planned_patches(splats: &Splats, cameras: &[Camera]) -> Result<u32> {
    let unit = Unit::of_splats(splats);
    let from = cameras.iter().map(|c| c.position().as_vec3().to_array());
    let places = splats.means.iter().copied().chain(from).map(|p| Vec3::from(unit.place(p)));
    let (low, high) = places.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let diagonal = low.distance(high);
    let around = MARGIN * diagonal;
    let enclosure = Enclosure::new((low - around).into(), (high + around).into(), PATCH_SHARE * diagonal)?;
    Ok(enclosure.patches().len() as u32)
}

/// Returns options of the search for nearest surfels.
///
/// `diagonal`: that of the room. `cell`: edge of a cell.
pub(crate) fn near(diagonal: f32, cell: f32) -> NearestOptions {
    NearestOptions { normal_length: NORMAL_SHARE * diagonal, least_distance: 0.1 * cell }
}

/// Returns the hemispherical reflectance of a surfel, diffuse and specular.
pub(crate) fn reflectance(m: &SurfelMaterial) -> [f32; 3] {
    // Seen at a cosine of 0.6, which stands for all directions.
    let specular = specular(m, 0.6);
    [0, 1, 2].map(|c| (m.albedo[c] * (1.0 - m.metallic) + specular[c]).min(1.0))
}

/// Returns the hemispherical reflectance of the specular lobe.
///
/// `facing` is the cosine between normal and direction to the viewer. Source: Karis 2014, an approximation of the split sum.
pub(crate) fn specular(m: &SurfelMaterial, facing: f32) -> [f32; 3] {
    let r = m.roughness;
    let q = [1.0 - r, 0.0425 - 0.0275 * r, 1.04 - 0.572 * r, 0.022 * r - 0.04];
    let a = (q[0] * q[0]).min((-9.28 * facing).exp2()) * q[0] + q[1];
    let (scale, bias) = (q[2] - 1.04 * a, q[3] + 1.04 * a);
    m.albedo.map(|albedo| ((0.04 * (1.0 - m.metallic) + albedo * m.metallic) * scale + bias).clamp(0.0, 1.0))
}

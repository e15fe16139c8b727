//! Shading of a run with materials and lights, and its images.

use crate::convert::{camera, gaussian_data};
use crate::directory::RunDirectory;
use crate::error::{Result, RunError};
use crate::lights::LightFile;
use crate::published::read_lights;
use crate::shadows::{Rays, traced};
use crate::visibility::{VisibilityFile, field_box};
use sgs_config::{Settings, VisibilityKind};
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    EnvironmentMemory, FrameEmitter, Shaded, ShadedEnvironment, ShadedLights, ShadedScene, ShadedVisibility, Shader,
    Surface,
};
use sgs_passes::scene::{Gaussians, Model, Trainable};
use sgs_passes::shade::environment::{Environment, EnvironmentOptions, latlong};
use sgs_passes::shade::visibility::VisibilityField;
use sgs_scene::{Image, Splats, Unit, linear_to_srgb, read_environment, srgb_to_linear};
use std::path::Path;

/// Environment map as texels of a cube map: `[6 * size * size * 3]` floats.
#[derive(Clone, Debug, PartialEq)]
pub struct Texels {
    /// Texels per edge of a face.
    pub size: u32,
    /// Linear radiance.
    pub data: Vec<f32>,
}

impl Texels {
    /// Reads a latitude-longitude image of linear radiance.
    ///
    /// # Errors
    /// If the file cannot be read or is not an environment map.
    pub fn read(path: &Path, size: u32) -> Result<Texels> {
        let image = read_environment(path)?;
        Ok(Texels { size, data: latlong::to_cube(&image.data, [image.width, image.height], size) })
    }

    /// Returns an environment map of one color.
    pub fn uniform(size: u32, color: [f32; 3]) -> Texels {
        Texels { size, data: color.repeat((6 * size * size) as usize) }
    }
}

/// Uploads splats with materials, lights and environment map to the device.
///
/// # Errors
/// If the splats have no materials or normals, or memory runs out.
pub fn shaded_scene(
    device: &Device,
    splats: &Splats,
    lights: Option<&LightFile>,
    environment: Option<&Texels>,
    visibility: &Visibility,
) -> Result<ShadedScene> {
    let missing = |what: &str| RunError::Refused(format!("The splats have no {what}; shading needs materials."));
    let albedo = splats.albedo.as_ref().ok_or_else(|| missing("albedo"))?;
    let roughness = splats.roughness.as_ref().ok_or_else(|| missing("roughness"))?;
    if splats.normals.is_none() {
        return Err(missing("normals"));
    }
    // Scenes that are small in their own unit would lie within the minimum distance of a light.
    let unit = Unit::of_splats(splats);
    let scaled = (unit != Unit::OWN).then(|| splats.clone().in_unit(unit));
    let splats = scaled.as_ref().unwrap_or(splats);
    let model = Model { sh_degree: 0, normals: true, semantics: false, mip: splats.antialiased };
    let gaussians = Gaussians::with(device, model, splats.len() as u32, false, false)?;
    gaussians.upload(device, &gaussian_data(splats, model))?;
    let lights = match lights {
        Some(file) => {
            let (model, positions, lobes, gains) = file.in_unit(unit).raw();
            Some(ShadedLights {
                model,
                normalizer: file.normalizer,
                positions: Trainable::new(device, "light_positions", &positions, false)?,
                lobes: Trainable::new(device, "light_lobes", &lobes, false)?,
                gains: Trainable::new(device, "light_gains", &gains, false)?,
            })
        }
        None => None,
    };
    let environment = match environment {
        Some(texels) => Some(shaded_environment(device, texels)?),
        None => None,
    };
    let visibility = match visibility {
        Visibility::Learned(file) => {
            let field = VisibilityField::new(device, file.config, 0, false, 32)?;
            field.upload(device, &file.tables, &file.mlp)?;
            Some(ShadedVisibility::Field { field, place: field_box(unit.place(file.low), unit.place(file.high)) })
        }
        Visibility::Traced(rays) => {
            let (memory, shape) = traced(device, splats, *rays)?;
            Some(ShadedVisibility::Traced { memory, shape })
        }
        Visibility::None => None,
    };
    Ok(ShadedScene {
        unit: unit.length() as f32,
        gaussians,
        albedo: Trainable::new(device, "albedo", albedo.as_flattened(), false)?,
        roughness: Trainable::new(device, "roughness", roughness, false)?,
        metallic: match &splats.metallic {
            Some(m) => Some(Trainable::new(device, "metallic", m, false)?),
            None => None,
        },
        lights,
        environment,
        visibility,
        transport: None,
    })
}

/// Uploads an environment map to the device.
///
/// # Errors
/// If the size is not supported, or memory runs out.
pub fn shaded_environment(device: &Device, texels: &Texels) -> Result<ShadedEnvironment> {
    let options = EnvironmentOptions { smoothness: None, ..EnvironmentOptions::default() };
    let tables = Environment::new(texels.size, &options).map_err(|e| RunError::Refused(e.to_string()))?;
    let memory = EnvironmentMemory::new(device, &tables)?;
    let texels = Trainable::new(device, "environment", &texels.data, false)?;
    Ok(ShadedEnvironment { tables, memory, texels })
}

/// Light of a run, read from its files.
#[derive(Clone, Debug, Default)]
pub struct RunLight {
    /// Point lights.
    pub lights: Option<LightFile>,
    /// Environment map.
    pub environment: Option<Texels>,
    /// Shadows of the lights.
    pub visibility: Visibility,
}

/// Shadows of the lights.
#[derive(Clone, Debug, Default)]
pub enum Visibility {
    /// No shadows.
    #[default]
    None,
    /// Visibility field, trained for the lights at their positions.
    Learned(Box<VisibilityFile>),
    /// Rays through the Gaussians.
    Traced(Rays),
}

/// Reads the light of a run: lights, environment map and visibility.
///
/// # Errors
/// If a file is damaged.
pub fn light_of(run: &RunDirectory, settings: &Settings) -> Result<RunLight> {
    let (lights, exr) = (run.path("lights.json"), run.path("environment.exr"));
    let lights = if lights.is_file() { Some(read_lights(&lights)?) } else { None };
    let size = settings.intrinsic.environment.edge();
    let environment = if exr.is_file() { Some(Texels::read(&exr, size)?) } else { None };
    let file = run.path("visibility.safetensors");
    let v = &settings.intrinsic.visibility;
    let visibility = match v.kind {
        VisibilityKind::Traced if lights.is_some() => Visibility::Traced(Rays::of(v)),
        _ if file.is_file() => Visibility::Learned(Box::new(VisibilityFile::load(&file)?)),
        _ => Visibility::None,
    };
    Ok(RunLight { lights, environment, visibility })
}

/// Shading of views of one scene.
pub struct Shading {
    device: Device,
    scene: ShadedScene,
    shader: Shader,
    /// Opacity of the last view where there was a surface.
    covered: Vec<f32>,
}

impl Shading {
    /// Prepares a scene.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, scene: ShadedScene) -> Result<Shading> {
        let shader = Shader::new(device, Tuning::for_device(device.info()), &scene, [1, 1])?;
        Ok(Shading { device: device.clone(), scene, shader, covered: Vec::new() })
    }

    /// Omits the mean visibility of the lights per pixel. It costs as much as shading.
    pub fn without_visibility(mut self) -> Shading {
        self.shader = self.shader.without_visibility();
        self
    }

    /// Shades a view.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn shade(&mut self, view: &sgs_scene::Camera) -> Result<ShadedView> {
        self.shade_from(&camera(view))
    }

    /// Shades a view as [`Shading::shade`], from a camera in the layout of the kernels.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn shade_from(&mut self, view: &sgs_passes::pipeline::Camera) -> Result<ShadedView> {
        let view = ShadedView(self.shader.shade(&self.scene, view)?);
        self.covered = view.covered();
        Ok(view)
    }

    /// Shades the last view again as [`Shading::shade`], under other light.
    ///
    /// [`Shading::set_emitters`] and [`Shading::set_gains`] change it.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn shade_again(&mut self, view: &sgs_scene::Camera) -> Result<ShadedView> {
        let view = ShadedView(self.shader.shade_again(&self.scene, &camera(view))?);
        self.covered = view.covered();
        Ok(view)
    }

    /// Sets the emitters of a scene with responses, in world units.
    ///
    /// Their number and shapes must be those of the scene.
    pub fn set_emitters(&mut self, emitters: &[FrameEmitter]) {
        self.scene.set_emitters(emitters);
    }

    /// Shades a view without readback and returns the elapsed seconds.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn time(&mut self, view: &sgs_scene::Camera) -> Result<f64> {
        Ok(self.shader.time(&self.scene, &camera(view))?)
    }

    /// Returns the light from point lights only, as [`ShadedView::direct`].
    ///
    /// Repeated calls with the same view and other gains cost little more than the lights that are on.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn direct(&mut self, view: &sgs_scene::Camera) -> Result<Image> {
        let data = self.direct_from(&camera(view))?;
        Ok(Image { width: view.width, height: view.height, channels: 3, data })
    }

    /// Returns the values of [`Shading::direct`] for a camera of the kernels.
    ///
    /// Returns 3 floats per pixel.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn direct_from(&mut self, view: &sgs_passes::pipeline::Camera) -> Result<Vec<f32>> {
        let mut direct = match self.shader.again(&self.scene, view)? {
            Some(direct) => direct,
            None => self.shade_from(view)?.0.direct,
        };
        direct.chunks_exact_mut(3).zip(&self.covered).for_each(|(light, c)| light.iter_mut().for_each(|v| *v *= c));
        Ok(direct)
    }

    /// Returns the linear RGB that each splat sends to `from`.
    ///
    /// Each splat is shaded alone, at its center.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn shade_centers(&mut self, splats: &Splats, from: [f32; 3]) -> Result<Vec<f32>> {
        let length_one = |n: &[f32; 3]| glam::Vec3::from(*n).normalize_or_zero().to_array();
        let normals: Vec<[f32; 3]> = splats.normals.iter().flatten().map(length_one).collect();
        let capacity = self.scene.gaussians.capacity;
        let unit = Unit::of_length(f64::from(self.scene.unit));
        let points: Vec<[f32; 3]> = splats.means.iter().map(|mean| unit.place(*mean)).collect();
        let (points, normals, from) = (points.as_flattened(), normals.as_flattened(), unit.place(from));
        let surface = Surface::of_gaussians(&self.device, points, normals, capacity)?;
        let shaded = self.shader.shade_centers(&self.scene, &surface, from)?;
        let mut light: Vec<f32> = shaded.direct.iter().zip(&shaded.ambient).map(|(d, a)| d + a).collect();
        light.truncate(3 * splats.len());
        Ok(light)
    }

    /// Sets the gain of each light; 0 is off.
    ///
    /// # Errors
    /// If the number of gains differs from the number of lights, or the device fails.
    pub fn set_gains(&mut self, device: &Device, gains: &[f32]) -> Result<()> {
        let lights = self.scene.lights.as_ref().map_or(0, |l| l.model.lights as usize);
        if gains.len() != lights {
            return Err(RunError::Refused(format!("{} gains were given for {lights} lights.", gains.len())));
        }
        if let Some(l) = &self.scene.lights {
            let by = self.scene.unit.powi(-2);
            let gains: Vec<f32> = gains.iter().map(|gain| gain * by).collect();
            l.gains.upload(device, &gains)?;
        }
        Ok(())
    }

    /// Returns the scene.
    pub fn scene(&self) -> &ShadedScene {
        &self.scene
    }
}

/// Channels of a shaded view as images.
#[derive(Clone, Debug)]
pub struct ShadedView(pub Shaded);

/// Minimum opacity of a pixel that has materials.
const LEAST_COVERAGE: f32 = 1e-3;

impl ShadedView {
    fn image(&self, channels: u32, data: Vec<f32>) -> Image {
        Image { width: self.0.size[0], height: self.0.size[1], channels, data }
    }

    fn pixels(&self) -> usize {
        self.0.coverage.len()
    }

    /// Returns the mean visibility of the lights per pixel; `None` if not computed.
    pub fn visibility(&self) -> Option<Image> {
        (!self.0.visibility.is_empty()).then(|| self.image(1, self.0.visibility.clone()))
    }

    /// Returns linear albedo.
    pub fn albedo(&self) -> Image {
        self.image(3, self.0.materials.chunks_exact(4).flat_map(|m| [m[0], m[1], m[2]]).collect())
    }

    /// Returns roughness.
    pub fn roughness(&self) -> Image {
        self.image(1, self.0.materials.chunks_exact(4).map(|m| m[3]).collect())
    }

    /// Returns metallic; zero if the scene has none.
    pub fn metallic(&self) -> Image {
        let none = self.0.metallic.is_empty();
        self.image(1, if none { vec![0.0; self.pixels()] } else { self.0.metallic.clone() })
    }

    /// Returns opacity.
    pub fn coverage(&self) -> Image {
        self.image(1, self.0.coverage.clone())
    }

    /// Returns unit normals in world space.
    pub fn normal(&self) -> Image {
        self.image(3, self.0.normals.clone())
    }

    /// Returns 1 where there is a surface, else 0, in one channel.
    pub fn surface(&self) -> Image {
        self.image(1, self.0.coverage.iter().map(|c| if *c >= LEAST_COVERAGE { 1.0 } else { 0.0 }).collect())
    }

    /// Returns opacity where there is a surface, else 0. Light is multiplied by it.
    pub fn covered(&self) -> Vec<f32> {
        self.0.coverage.iter().map(|c| if *c >= LEAST_COVERAGE { *c } else { 0.0 }).collect()
    }

    fn over(&self, parts: &[&[f32]], background: [f32; 3]) -> Image {
        let behind = background.map(srgb_to_linear);
        let pixel = |p: usize| {
            let c = if self.0.coverage[p] >= LEAST_COVERAGE { self.0.coverage[p] } else { 0.0 };
            [0, 1, 2].map(|k| {
                let light: f32 = parts.iter().filter_map(|part| part.get(3 * p + k)).sum();
                light * c + (1.0 - c) * behind[k]
            })
        };
        self.image(3, (0..self.pixels()).flat_map(pixel).collect())
    }

    /// Returns all linear light over a display-referred background.
    pub fn radiance(&self, background: [f32; 3]) -> Image {
        self.over(&[&self.0.direct, &self.0.ambient, &self.0.indirect, &self.0.emission], background)
    }

    /// Returns the linear light from point lights over black.
    pub fn direct(&self) -> Image {
        self.over(&[&self.0.direct], [0.0; 3])
    }

    /// Returns the linear light of the environment map over black.
    pub fn ambient(&self) -> Image {
        self.over(&[&self.0.ambient], [0.0; 3])
    }

    /// Returns the linear light of the environment map on surfaces.
    ///
    /// The background is the map itself.
    pub fn environment_map(&self) -> Image {
        let mut image = self.ambient();
        for (p, color) in image.data.chunks_exact_mut(3).enumerate() {
            let c = if self.0.coverage[p] >= LEAST_COVERAGE { self.0.coverage[p] } else { 0.0 };
            let behind = self.0.background.get(3 * p..3 * p + 3).unwrap_or(&[0.0; 3]);
            color.iter_mut().zip(behind).for_each(|(v, b)| *v += (1.0 - c) * b);
        }
        image
    }

    /// Returns linear diffuse light over black.
    pub fn diffuse(&self) -> Image {
        self.over(&[&self.0.direct_diffuse, &self.0.ambient_diffuse], [0.0; 3])
    }

    /// Returns linear specular light over black.
    pub fn specular(&self) -> Image {
        let all = self.over(&[&self.0.direct, &self.0.ambient], [0.0; 3]);
        let diffuse = self.diffuse();
        let data = all.data.iter().zip(&diffuse.data).map(|(a, d)| a - d).collect();
        self.image(3, data)
    }
}

/// Converts a linear image to display values.
pub fn displayed(linear: &Image) -> Image {
    let data = linear.data.iter().map(|v| linear_to_srgb(v.clamp(0.0, 1.0))).collect();
    Image { data, ..linear.clone() }
}

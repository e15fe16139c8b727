//! Workload of training: views on the device, and initial Gaussians.

mod lit;
mod room;
mod synthetic;

pub use lit::{LitScene, lit_settings, plain};
pub use synthetic::{Synthetic, synthetic};

use sgs_config::Settings;
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::pipeline::{Camera, Inputs};
use sgs_passes::reference::project as reference;
use sgs_passes::scene::{Decoder, GaussianData, Group, Model};
use sgs_run::gaussian_data;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_train::{Correspondence, Photographs, PixelPriors, SemanticData, TrainingData};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Scene that is ready for training.
pub struct Workload {
    /// Name of the scene.
    pub name: String,
    /// Parameter groups of the Gaussians.
    pub model: Model,
    /// Initial Gaussians.
    pub start: GaussianData,
    /// Packed photographs.
    pub targets: DeviceBuffer,
    /// Packed normal priors.
    pub normals: Option<DeviceBuffer>,
    /// Semantic priors and the decoder.
    pub semantics: Option<Arc<(SemanticData, Decoder)>>,
    /// Pseudo-views and their regions.
    pub correspondence: Option<Arc<Mutex<Correspondence>>>,
    /// Cameras, and the index of the first pixel of each photograph.
    pub views: Vec<(Camera, u32)>,
    /// Maximum width and height of the views.
    pub largest: [u32; 2],
    /// Extent of the scene.
    pub extent: f64,
    /// Training settings.
    pub settings: Settings,
}

/// Returns training settings with everything at its full size from the first step.
///
/// All steps of a benchmark then cost the same.
fn settings(densify: bool, sh_degree: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.sh_degree = sh_degree.into();
    if !densify {
        s.geometry.densify.until = 0.0;
    }
    s
}

/// Priors that a scene directory is trained with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Priors {
    /// Normals, with depth.
    pub normals: bool,
    /// Semantic features.
    pub semantics: bool,
    /// Pseudo-views, which need semantic features.
    pub pseudo: bool,
}

impl Workload {
    /// Returns the input buffers of a step.
    pub fn inputs(&self) -> Inputs<'_> {
        let semantics = self.semantics.as_deref().map(|(data, decoder)| data.inputs(decoder));
        Inputs { normals: self.normals.as_ref(), semantics, ..Inputs::of(&self.targets) }
    }
}

/// Loads the training views of a scene directory, and splats from its points.
///
/// # Errors
/// If the scene cannot be read or memory runs out.
pub fn directory(
    device: &Device,
    path: &Path,
    priors: Priors,
    densify: bool,
    sh_degree: u32,
) -> anyhow::Result<Workload> {
    let scene = Scene::open(path, &SceneOptions::default())?;
    let data = TrainingData::load(device, &scene, PixelPriors { normals: priors.normals, depths: false })?;
    let [photographs] = <[Photographs; 1]>::try_from(data.parts)
        .map_err(|_| anyhow::anyhow!("The photographs of \"{}\" exceed one binding of the device.", path.display()))?;
    let normals = photographs.normals;
    anyhow::ensure!(!priors.normals || normals.is_some(), "\"{}\" has no normal priors.", path.display());
    let maps = if priors.semantics { SemanticData::load(device, &scene)? } else { None };
    anyhow::ensure!(!priors.semantics || maps.is_some(), "\"{}\" has no semantic priors.", path.display());
    let semantics = match maps {
        Some(maps) => Some(Arc::new((maps, Decoder::new(device, 0, true)?))),
        None => None,
    };
    let settings = settings(densify, sh_degree);
    let correspondence = match semantics.as_deref().filter(|_| priors.pseudo) {
        Some((maps, _)) => Correspondence::load(device, &scene, maps, &settings, data.largest)?,
        None => None,
    };
    anyhow::ensure!(!priors.pseudo || correspondence.is_some(), "\"{}\" has no regions.", path.display());
    let correspondence = correspondence.map(|c| Arc::new(Mutex::new(c)));
    let model = Model { sh_degree, normals: normals.is_some(), semantics: semantics.is_some(), mip: false };
    let splats = Splats::from_points(&scene.points, sh_degree as usize)?;
    Ok(Workload {
        name: path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
        model,
        start: gaussian_data(&splats, model),
        targets: photographs.targets,
        normals,
        semantics,
        correspondence,
        views: data.views,
        largest: data.largest,
        extent: scene.extent(),
        settings,
    })
}

/// Converts Gaussians to the CPU reference.
pub fn reference_gaussians(d: &GaussianData) -> reference::Gaussians {
    let wide = |g: Group| d.group(g).iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
    reference::Gaussians {
        means: wide(Group::Means),
        log_scales: wide(Group::LogScales),
        rotations: wide(Group::Rotations),
        opacity_logits: wide(Group::OpacityLogits),
        sh: [wide(Group::Sh0), wide(Group::Sh1), wide(Group::Sh2), wide(Group::Sh3)],
        normals: wide(Group::Normals),
        semantics: wide(Group::Semantics),
        mip: false,
    }
}

/// Converts a camera to the CPU reference.
pub fn reference_camera(c: &Camera) -> reference::Camera {
    let w = c.world_to_camera.map(|row| row.map(f64::from));
    let column = |k: usize| glam::DVec3::new(w[0][k], w[1][k], w[2][k]);
    reference::Camera {
        rotation: glam::DMat3::from_cols(column(0), column(1), column(2)),
        translation: column(3),
        focal: glam::DVec2::new(f64::from(c.focal[0]), f64::from(c.focal[1])),
        center: glam::DVec2::new(f64::from(c.center[0]), f64::from(c.center[1])),
        size: c.size,
        near: f64::from(c.near),
        radial: f64::from(c.radial),
    }
}

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
use sgs_train::{Correspondence, SemanticData, TrainingData};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// A scene, ready to be trained on.
pub struct Workload {
    /// Where it comes from.
    pub name: String,
    /// Which groups the Gaussians have.
    pub model: Model,
    /// The Gaussians that training starts from.
    pub start: GaussianData,
    /// Photographs, packed.
    pub targets: DeviceBuffer,
    /// Normal priors, packed.
    pub normals: Option<DeviceBuffer>,
    /// Semantic priors and the decoder.
    pub semantics: Option<Arc<(SemanticData, Decoder)>>,
    /// Pseudo-views and their regions.
    pub correspondence: Option<Arc<Mutex<Correspondence>>>,
    /// Cameras, and the first pixel of each one's photograph.
    pub views: Vec<(Camera, u32)>,
    /// Columns and rows that no view exceeds.
    pub largest: [u32; 2],
    /// The scene's size.
    pub extent: f64,
    /// How it is trained.
    pub settings: Settings,
}

/// Settings of a benchmark: those of training, with everything that starts small or late there at its full size, so that
/// every step costs the same.
fn settings(densify: bool, sh_degree: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.sh_degree = sh_degree.into();
    s.geometry.sh_interval = 0;
    s.geometry.densify.enabled = densify;
    s
}

/// Which priors a scene directory is trained with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Priors {
    /// Normals, with depth.
    pub normals: bool,
    /// Semantic features.
    pub semantics: bool,
    /// Pseudo-views beside these.
    pub pseudo: bool,
}

impl Workload {
    /// Buffers that a step is bound to.
    pub fn inputs(&self) -> Inputs<'_> {
        Inputs {
            targets: &self.targets,
            normals: self.normals.as_ref(),
            semantics: self.semantics.as_deref().map(|(data, decoder)| data.inputs(decoder)),
            regions: None,
            pseudo_regions: None,
        }
    }
}

/// A scene directory: its training views, and splats from its points.
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
    let data = TrainingData::load(device, &scene, priors.normals)?;
    anyhow::ensure!(!priors.normals || data.normals.is_some(), "\"{}\" has no normal priors.", path.display());
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
    let model = Model { sh_degree, normals: data.normals.is_some(), semantics: semantics.is_some() };
    let splats = Splats::from_points(&scene.points, sh_degree as usize)?;
    Ok(Workload {
        name: path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
        model,
        start: gaussian_data(&splats, model),
        targets: data.targets,
        normals: data.normals,
        semantics,
        correspondence,
        views: data.views,
        largest: data.largest,
        extent: scene.extent(),
        settings,
    })
}

/// Gaussians as the CPU reference takes them.
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
    }
}

/// A camera as the CPU reference takes it.
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
    }
}

//! Generation of the priors of a scene: photographs in, `priors/` out.
//!
//! Photographs are sent as stored, with their distortion, because priors are stored the same way. Each file is written
//! completely or not at all. Existing files stay, so a second run continues an interrupted one.

mod depth_normals;
mod regions;
mod view;
mod write;

use crate::error::ProviderError;
use crate::offer::Encoding;
use crate::provider::Provider;
use crate::question::ProviderImage;
use sgs_scene::{Image, NormalFrame, Scene, SceneError, linear_to_srgb};
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

pub use depth_normals::fill_normals_from_depth;

/// Largest number of images in a question for class names.
const SEEN: usize = 8;

/// Kind of prior, named by its folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Prior {
    /// Unit normals.
    Normal,
    /// Depth, and its confidence.
    Depth,
    /// Feature maps, and the names and embeddings of classes.
    Semantic,
    /// Region numbers.
    Masks,
    /// Base color.
    Albedo,
    /// Roughness.
    Roughness,
    /// Metallic.
    Metallic,
}

impl Prior {
    /// All kinds.
    pub const ALL: [Prior; 7] =
        [Prior::Normal, Prior::Depth, Prior::Semantic, Prior::Masks, Prior::Albedo, Prior::Roughness, Prior::Metallic];

    /// Returns the name of the folder.
    pub fn name(self) -> &'static str {
        match self {
            Prior::Normal => "normal",
            Prior::Depth => "depth",
            Prior::Semantic => "semantic",
            Prior::Masks => "masks",
            Prior::Albedo => "albedo",
            Prior::Roughness => "roughness",
            Prior::Metallic => "metallic",
        }
    }

    /// Returns the questions of which a provider must offer at least one.
    fn questions(self) -> &'static [&'static str] {
        match self {
            Prior::Normal => &["normals"],
            Prior::Depth => &["depth"],
            Prior::Semantic => &["semantics", "text"],
            Prior::Masks => &["regions"],
            Prior::Albedo | Prior::Roughness | Prior::Metallic => &["materials"],
        }
    }

    /// Returns true if a provider offers this prior.
    pub fn is_offered(self, provider: &Provider) -> bool {
        match self {
            Prior::Albedo | Prior::Roughness | Prior::Metallic => {
                provider.about().offers.get("materials").is_some_and(|o| o.maps.iter().any(|m| m == self.name()))
            }
            _ => self.questions().iter().any(|q| provider.offers(q)),
        }
    }
}

impl fmt::Display for Prior {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Prior {
    type Err = String;

    fn from_str(text: &str) -> Result<Prior, String> {
        let names = Prior::ALL.map(Prior::name).join(", ");
        Prior::ALL
            .into_iter()
            .find(|p| p.name() == text.trim())
            .ok_or_else(|| format!("\"{text}\" is no kind of prior; there are {names}"))
    }
}

/// Options of prior generation.
#[derive(Clone, Debug, Default)]
pub struct FillOptions {
    /// Requested kinds. Empty selects all kinds that the provider offers.
    pub only: Vec<Prior>,
    /// Requested views, by their index in the scene.
    pub views: Vec<usize>,
    /// Overwrites existing files.
    pub force: bool,
    /// Names of classes. Empty uses existing names, or asks the provider.
    pub labels: Vec<String>,
}

/// Result of prior generation.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filled {
    /// Written files.
    pub written: Vec<PathBuf>,
    /// Number of existing files that were not overwritten.
    pub existing: usize,
    /// True if all views are done and the run was not interrupted.
    pub complete: bool,
    /// Warnings for the user, one sentence each.
    pub warnings: Vec<String>,
}

/// Failure of prior generation.
#[derive(Debug, thiserror::Error)]
pub enum FillError {
    /// Failure of the provider.
    #[error(transparent)]
    Provider(#[from] ProviderError),
    /// Photograph that cannot be read, or file that cannot be written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// File operation that failed under `priors/`.
    #[error("cannot write {}: {cause}", path.display())]
    Write {
        /// File or folder.
        path: PathBuf,
        /// Reason reported by the system.
        cause: std::io::Error,
    },
    /// Requested prior that the provider does not offer.
    #[error("the provider \"{name}\" cannot make the prior \"{prior}\"; it offers {offers}")]
    NotOffered {
        /// Name of the provider.
        name: String,
        /// Requested prior.
        prior: Prior,
        /// Offered questions.
        offers: String,
    },
    /// Conflict between existing files, the provider and the requested priors.
    #[error("{0}")]
    Unfit(String),
}

/// Generates priors of a scene.
///
/// `progress` receives the number of finished and of all views. `go_on` is called before each view; `false` interrupts
/// the run.
///
/// # Errors
/// The first failure. Files written before it stay.
pub fn fill(
    scene: &Scene,
    provider: &mut Provider,
    options: &FillOptions,
    mut progress: impl FnMut(usize, usize),
    mut go_on: impl FnMut() -> bool,
) -> Result<Filled, FillError> {
    let mut filled = Filled::default();
    let mut kinds = options.only.clone();
    if kinds.is_empty() {
        kinds = Prior::ALL.into_iter().filter(|p| p.is_offered(provider)).collect();
    }
    if let Some(&prior) = kinds.iter().find(|p| !p.is_offered(provider)) {
        let (name, offers) = (provider.about().name.clone(), provider.about().list());
        return Err(FillError::NotOffered { name, prior, offers });
    }
    if kinds.is_empty() {
        return Err(FillError::Unfit(format!(
            "the provider \"{}\" makes no priors; it offers {}",
            provider.about().name,
            provider.about().list()
        )));
    }
    let mut writer = write::Writer::open(scene, options, &mut filled)?;
    if kinds.contains(&Prior::Semantic) {
        classes(scene, provider, options, &mut writer)?;
    }
    for (done, &index) in options.views.iter().enumerate() {
        progress(done, options.views.len());
        if !go_on() {
            return Ok(filled);
        }
        view::fill(scene, index, provider, &kinds, &mut writer)?;
    }
    progress(options.views.len(), options.views.len());
    filled.complete = true;
    Ok(filled)
}

/// Writes the names and embeddings of classes.
fn classes(
    scene: &Scene,
    provider: &mut Provider,
    options: &FillOptions,
    writer: &mut write::Writer,
) -> Result<(), FillError> {
    if !writer.wants_classes(options) {
        return Ok(());
    }
    if !provider.offers("text") {
        writer
            .warn("the provider offers no embeddings of texts, so priors/semantic has none yet; ask another for them");
        return Ok(());
    }
    let names = if !options.labels.is_empty() {
        options.labels.clone()
    } else if let Some(names) = writer.labels()? {
        names
    } else if provider.offers("classes") {
        let step = options.views.len().div_ceil(SEEN).max(1);
        let images: Vec<Image> =
            options.views.iter().step_by(step).map(|&i| plain(scene, i)).collect::<Result<_, _>>()?;
        let renderings: Vec<ProviderImage> = images.iter().map(ProviderImage::srgb).collect();
        provider.classes(&renderings)?
    } else {
        writer.warn("nobody names the classes, so priors/semantic has no embeddings yet; give names with --labels");
        return Ok(());
    };
    let (channels, embeddings) = provider.text(&names)?;
    writer.classes(&names, channels, &embeddings)
}

/// Returns a photograph in sRGB encoding.
fn plain(scene: &Scene, index: usize) -> Result<Image, SceneError> {
    let mut stored = scene.view(index)?.load_stored(&scene.load_options())?;
    if stored.linear {
        stored.image.data.iter_mut().for_each(|v| *v = linear_to_srgb(v.clamp(0.0, 1.0)));
    }
    Ok(stored.image)
}

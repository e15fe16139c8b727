//! Priors on disk from a provider's answers: the photographs of a scene in, `priors/` out.
//!
//! Photographs are sent as they are stored, with their distortion, since that is how priors are stored too. Files are
//! written whole or not at all; what exists is kept, so an interrupted run is gone on with by running it again.

mod regions;
mod view;
mod write;

use crate::error::ProviderError;
use crate::offer::Encoding;
use crate::provider::Provider;
use crate::question::Picture;
use sgs_scene::{Image, NormalFrame, Scene, SceneError, linear_to_srgb};
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// The most images that class names are asked from.
const SEEN: usize = 8;

/// The kinds of priors, by the names of their folders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Prior {
    /// Unit normals.
    Normal,
    /// Feature maps, and the classes' names and embeddings.
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
    pub const ALL: [Prior; 6] =
        [Prior::Normal, Prior::Semantic, Prior::Masks, Prior::Albedo, Prior::Roughness, Prior::Metallic];

    /// The name of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Prior::Normal => "normal",
            Prior::Semantic => "semantic",
            Prior::Masks => "masks",
            Prior::Albedo => "albedo",
            Prior::Roughness => "roughness",
            Prior::Metallic => "metallic",
        }
    }

    /// The questions of which at least one must be offered.
    fn questions(self) -> &'static [&'static str] {
        match self {
            Prior::Normal => &["normals"],
            Prior::Semantic => &["semantics", "text"],
            Prior::Masks => &["regions"],
            Prior::Albedo | Prior::Roughness | Prior::Metallic => &["materials"],
        }
    }

    /// Whether a provider can make it.
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

/// What to make.
#[derive(Clone, Debug, Default)]
pub struct FillOptions {
    /// These kinds; empty for all that the provider offers.
    pub only: Vec<Prior>,
    /// For these views, by their index in the scene.
    pub views: Vec<usize>,
    /// Whether files that exist are made anew.
    pub force: bool,
    /// Names of classes; empty to keep those there are, or ask the provider.
    pub labels: Vec<String>,
}

/// What was done.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filled {
    /// Files written.
    pub written: Vec<PathBuf>,
    /// Files that were there and were kept.
    pub kept: usize,
    /// Whether all was done, and nobody interrupted.
    pub complete: bool,
    /// What the user should know, one sentence each.
    pub warnings: Vec<String>,
}

/// Why priors could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FillError {
    /// The provider failed.
    #[error(transparent)]
    Provider(#[from] ProviderError),
    /// A photograph cannot be read, or a file not be written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A folder cannot be made or a file not be moved.
    #[error("cannot write {}: {cause}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        cause: std::io::Error,
    },
    /// The provider does not do what was asked for.
    #[error("the provider \"{name}\" cannot make the prior \"{prior}\"; it offers {offers}")]
    NotOffered {
        /// The provider's name.
        name: String,
        /// What was asked for.
        prior: Prior,
        /// What it offers.
        offers: String,
    },
    /// What is there and what came do not fit together.
    #[error("{0}")]
    Unfit(String),
}

/// Makes priors of a scene. `progress` hears how many views are done; `go_on` is asked before each.
///
/// # Errors
/// The first failure; files written until then stay.
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

/// Names and embeddings of the classes.
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
        let pictures: Vec<Picture> = images.iter().map(Picture::srgb).collect();
        provider.classes(&pictures)?
    } else {
        writer.warn("nobody names the classes, so priors/semantic has no embeddings yet; give names with --labels");
        return Ok(());
    };
    let (channels, embeddings) = provider.text(&names)?;
    writer.classes(&names, channels, &embeddings)
}

/// A photograph as anybody would look at it: sRGB-encoded.
fn plain(scene: &Scene, index: usize) -> Result<Image, SceneError> {
    let mut stored = scene.view(index)?.load_stored(&scene.load_options())?;
    if stored.linear {
        stored.image.data.iter_mut().for_each(|v| *v = linear_to_srgb(v.clamp(0.0, 1.0)));
    }
    Ok(stored.image)
}

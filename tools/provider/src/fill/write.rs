//! Files of `priors/`.

use super::regions::Numbers;
use super::{FillError, FillOptions, Filled, NormalFrame, Prior, Scene};
use crate::question::{Depth, Features, Materials, Regions};
use serde_json::{Map, Value, json};
use sgs_scene::{
    DepthMeaning, Image, atomic_write, read_ids, write_exr, write_ids, write_npy_f16, write_npy_f32, write_png,
};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// File extensions of priors, as recognized by the scene crate.
const EXTENSIONS: [&str; 3] = ["exr", "npy", "png"];

/// Writer of a scene's priors.
pub(super) struct Writer<'a> {
    root: PathBuf,
    force: bool,
    settings: Map<String, Value>,
    frame: Option<NormalFrame>,
    /// Recorded meaning of depths.
    meaning: Option<DepthMeaning>,
    /// Whether depths are on disk that stay.
    has_depths: bool,
    numbers: Option<Numbers>,
    /// Views whose files are overwritten.
    renewed: Vec<String>,
    channels: Option<usize>,
    filled: &'a mut Filled,
}

impl<'a> Writer<'a> {
    /// Inspects the existing files.
    pub(super) fn open(scene: &Scene, options: &FillOptions, filled: &'a mut Filled) -> Result<Writer<'a>, FillError> {
        let root = scene.root.join("priors");
        let path = root.join("priors.json");
        let settings = match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text)
                .map_err(|e| FillError::Unfit(format!("{} is not what it should be: {e}", path.display())))?,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Map::new(),
            Err(cause) => return Err(FillError::Write { path, cause }),
        };
        let frame = settings.get("normal").and_then(|n| serde_json::from_value(n["frame"].clone()).ok());
        let renewed = match options.force {
            true => options.views.iter().filter_map(|&i| Some(scene.views.get(i)?.camera.name.clone())).collect(),
            false => Vec::new(),
        };
        let recorded = settings.get("depth").map(|depth| depth["meaning"].clone());
        let mut meaning = recorded.and_then(|word| serde_json::from_value(word).ok());
        let has_depths = has_others(&root.join(Prior::Depth.name()), &renewed);
        if has_depths {
            meaning = meaning.or(Some(DepthMeaning::default()));
        }
        let (force, numbers, channels) = (options.force, None, None);
        Ok(Writer { root, force, settings, frame, meaning, has_depths, numbers, renewed, channels, filled })
    }

    /// Adds a warning for the user.
    pub(super) fn warn(&mut self, sentence: &str) {
        self.filled.warnings.push(sentence.to_owned());
    }

    /// Returns true if a file must be made. Counts a file that stays.
    pub(super) fn lacks(&mut self, prior: Prior, view: &str) -> bool {
        let folder = self.root.join(prior.name());
        let there = EXTENSIONS.iter().any(|e| folder.join(format!("{view}.{e}")).is_file());
        self.filled.existing += usize::from(there && !self.force);
        !there || self.force
    }

    /// Returns the frame of the normals on disk.
    ///
    /// Existing files decide; otherwise it is the provider's frame. The frame is written before the first file, so
    /// normals never lack it.
    pub(super) fn frame(&mut self, offered: NormalFrame) -> Result<NormalFrame, FillError> {
        let frame = match self.frame {
            Some(frame) => frame,
            None => {
                self.settings.insert("normal".into(), json!({ "frame": offered }));
                self.write_settings()?;
                offered
            }
        };
        self.frame = Some(frame);
        Ok(frame)
    }

    /// Records the meaning of the provider's depths before the first file.
    ///
    /// Fails if depths with another meaning are on disk and stay.
    pub(super) fn meaning(&mut self, offered: DepthMeaning) -> Result<(), FillError> {
        if self.meaning == Some(offered) {
            return Ok(());
        }
        if let (true, Some(meaning)) = (self.has_depths, self.meaning) {
            return Err(FillError::Unfit(format!(
                "{} has {} depths, but those of the provider are {}; a scene has one kind, so remove the folder, or \
                 replace all with --force",
                self.root.join(Prior::Depth.name()).display(),
                meaning.name(),
                offered.name()
            )));
        }
        // The unit of other depths does not apply.
        self.settings.insert("depth".into(), json!({ "meaning": offered.name() }));
        self.write_settings()?;
        self.meaning = Some(offered);
        Ok(())
    }

    fn write_settings(&self) -> Result<(), FillError> {
        make(&self.root)?;
        let path = self.root.join("priors.json");
        let text = format!("{:#}\n", Value::Object(self.settings.clone()));
        Ok(atomic_write(&path, |f| f.write_all(text.as_bytes()))?)
    }

    /// Writes depth, and its confidence into a folder of its own.
    ///
    /// Confidence is written first, so that no depth lacks its own.
    pub(super) fn depth(&mut self, view: &str, found: &Depth) -> Result<(), FillError> {
        let folder = self.root.join(Prior::Depth.name()).join("confidence");
        for old in EXTENSIONS.map(|extension| folder.join(format!("{view}.{extension}"))) {
            if old.is_file() {
                std::fs::remove_file(&old).map_err(|cause| FillError::Write { path: old, cause })?;
            }
        }
        if let Some(confidence) = &found.confidence {
            make(&folder)?;
            let path = folder.join(format!("{view}.png"));
            write_png(&path, confidence)?;
            self.filled.written.push(path);
        }
        self.place(Prior::Depth, view, "exr", |path| Ok(write_exr(path, &found.image, &["Z"])?))
    }

    /// Writes normals unchanged. Zero marks unknown pixels.
    pub(super) fn normal(&mut self, view: &str, image: &Image) -> Result<(), FillError> {
        self.place(Prior::Normal, view, "exr", |path| Ok(write_exr(path, image, &["R", "G", "B"])?))
    }

    /// Writes features.
    pub(super) fn features(&mut self, view: &str, features: &Features) -> Result<(), FillError> {
        let channels = features.shape[2];
        if let Some(others) = self.embedding_channels().filter(|n| *n != channels) {
            return Err(FillError::Unfit(format!(
                "the features of view {view} have {channels} numbers a cell, but the embeddings in priors/semantic have \
                 {others}; both must come from networks that belong together"
            )));
        }
        self.place(Prior::Semantic, view, "npy", |path| Ok(write_npy_f16(path, &features.shape, &features.data)?))
    }

    /// Writes regions. Renumbers them unless `same` is set.
    pub(super) fn regions(&mut self, view: &str, mut found: Regions, same: bool) -> Result<(), FillError> {
        if !same {
            if self.numbers.is_none() {
                self.numbers = Some(Numbers::above(self.highest()?));
            }
            let all = self.numbers.as_mut().and_then(|n| n.renumber(&mut found.ids));
            if all.is_none() {
                let problem =
                    format!("with the regions of view {view} the scene has more than 65535; ask for larger ones");
                return Err(FillError::Unfit(problem));
            }
        }
        self.place(Prior::Masks, view, "png", |path| Ok(write_ids(path, found.size[0], found.size[1], &found.ids)?))
    }

    /// Writes materials: linear albedo as EXR, other maps as PNG.
    ///
    /// Transparent pixels of a PNG are unknown.
    pub(super) fn materials(&mut self, view: &str, found: &Materials) -> Result<(), FillError> {
        if let Some(image) = &found.albedo {
            if found.albedo_is_linear {
                self.place(Prior::Albedo, view, "exr", |path| Ok(write_exr(path, image, &["R", "G", "B"])?))?;
            } else {
                self.place(Prior::Albedo, view, "png", |path| Ok(write_png(path, &with_alpha(image))?))?;
            }
        }
        for (prior, image) in [(Prior::Roughness, &found.roughness), (Prior::Metallic, &found.metallic)] {
            if let Some(image) = image {
                self.place(prior, view, "png", |path| Ok(write_png(path, &with_alpha(image))?))?;
            }
        }
        Ok(())
    }

    /// Returns true if names and embeddings of classes must be made.
    pub(super) fn wants_classes(&mut self, options: &FillOptions) -> bool {
        let there = self.semantic("text_embeddings.npy").is_file() && self.semantic("labels.json").is_file();
        let wanted = !there || self.force || !options.labels.is_empty();
        self.filled.existing += 2 * usize::from(!wanted);
        wanted
    }

    /// Returns the names of the existing classes.
    pub(super) fn labels(&self) -> Result<Option<Vec<String>>, FillError> {
        let path = self.semantic("labels.json");
        let Ok(text) = std::fs::read_to_string(&path) else { return Ok(None) };
        let read =
            serde_json::from_str::<Value>(&text).ok().and_then(|v| serde_json::from_value(v["labels"].clone()).ok());
        let names = read.ok_or_else(|| FillError::Unfit(format!("{} holds no list of \"labels\"", path.display())))?;
        Ok(Some(names))
    }

    /// Writes names and embeddings of classes.
    pub(super) fn classes(&mut self, names: &[String], channels: usize, embeddings: &[f32]) -> Result<(), FillError> {
        make(&self.root.join("semantic"))?;
        // Names are written first: embeddings without names are unreadable, names without embeddings are harmless.
        let embedded = self.semantic("text_embeddings.npy");
        if embedded.is_file() {
            std::fs::remove_file(&embedded).map_err(|cause| FillError::Write { path: embedded.clone(), cause })?;
        }
        let path = self.semantic("labels.json");
        let text = format!("{:#}\n", json!({"labels": names, "dim": channels}));
        atomic_write(&path, |f| f.write_all(text.as_bytes()))?;
        write_npy_f32(&embedded, &[names.len(), channels], embeddings)?;
        self.filled.written.extend([path, embedded]);
        self.channels = Some(channels);
        Ok(())
    }

    fn semantic(&self, name: &str) -> PathBuf {
        self.root.join("semantic").join(name)
    }

    /// Returns the number of channels of the embeddings on disk.
    fn embedding_channels(&mut self) -> Option<usize> {
        if self.channels.is_none() {
            let found = sgs_scene::NpyArray::read(&self.semantic("text_embeddings.npy")).ok();
            self.channels = found.and_then(|a| a.shape.get(1).copied());
        }
        self.channels
    }

    /// Returns the highest region number that stays in use.
    fn highest(&self) -> Result<u16, FillError> {
        let mut highest = 0;
        for entry in std::fs::read_dir(self.root.join("masks")).into_iter().flatten().flatten() {
            let path = entry.path();
            let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
            if path.extension().is_some_and(|e| e == "png") && !self.renewed.contains(&stem) {
                highest = highest.max(read_ids(&path)?.2.into_iter().max().unwrap_or(0));
            }
        }
        Ok(highest)
    }

    /// Writes one file and removes files of the same prior with other extensions.
    fn place(
        &mut self,
        prior: Prior,
        view: &str,
        extension: &str,
        write: impl FnOnce(&Path) -> Result<(), FillError>,
    ) -> Result<(), FillError> {
        let folder = self.root.join(prior.name());
        make(&folder)?;
        let path = folder.join(format!("{view}.{extension}"));
        write(&path)?;
        for other in EXTENSIONS.iter().filter(|e| **e != extension) {
            let other = folder.join(format!("{view}.{other}"));
            if other.is_file() {
                std::fs::remove_file(&other).map_err(|cause| FillError::Write { path: other, cause })?;
            }
        }
        self.filled.written.push(path);
        Ok(())
    }
}

/// Returns true if a folder has files of other views than these.
fn has_others(folder: &Path, views: &[String]) -> bool {
    std::fs::read_dir(folder).into_iter().flatten().flatten().any(|entry| {
        let path = entry.path();
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        path.is_file() && !views.contains(&stem)
    })
}

fn make(folder: &Path) -> Result<(), FillError> {
    std::fs::create_dir_all(folder).map_err(|cause| FillError::Write { path: folder.to_owned(), cause })
}

/// Adds an alpha channel if some pixels are not finite.
fn with_alpha(image: &Image) -> Image {
    if image.data.iter().all(|v| v.is_finite()) {
        return image.clone();
    }
    let channels = image.channels as usize;
    let pixels = image.data.chunks_exact(channels).flat_map(|p| {
        let known = p.iter().all(|v| v.is_finite());
        let color = p.iter().map(move |v| if known { *v } else { 0.0 });
        color.chain(std::iter::once(f32::from(u8::from(known))))
    });
    Image { width: image.width, height: image.height, channels: image.channels + 1, data: pixels.collect() }
}

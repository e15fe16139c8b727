//! Steps from photographs or a video to a scene.

use crate::colmap::{Colmap, Pairs};
use crate::error::{CaptureError, Result, io_error};
use crate::groups::Group;
use crate::photographs;
use crate::prepared::Prepared;
use crate::process::Processes;
use crate::record::{Captured, Unregistered};
use crate::video;
use sgs_scene::{ColmapModel, Scene, SceneOptions, atomic_write};
use std::collections::{HashMap, HashSet};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Most frames of a video whose pairs are all matched by default.
const ALL_PAIRS: usize = 100;

/// Pairs of images that COLMAP matches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matcher {
    /// All pairs.
    Exhaustive,
    /// Images that follow each other in the order of their names.
    Sequential,
}

/// Options of a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptureOptions {
    /// Most frames that are taken from a video.
    pub frames: usize,
    /// Pairs of images. By default all, but neighbors for more than 100 frames of a video.
    pub matcher: Option<Matcher>,
}

impl Default for CaptureOptions {
    fn default() -> Self {
        Self { frames: 120, matcher: None }
    }
}

/// Writes a scene from a folder of photographs or a video.
///
/// `output` must not exist, or be an empty directory. `progress` receives a phrase before each step. A raised `stop`
/// ends the programs and the capture.
pub fn capture(
    source: &Path,
    output: &Path,
    options: &CaptureOptions,
    stop: &AtomicBool,
    progress: &dyn Fn(&str),
) -> Result<Captured> {
    let begun = Instant::now();
    let files = input(source)?;
    let parent = match output.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(parent).map_err(io_error("create", parent))?;
    let prefix = format!(".{}.", output.file_name().unwrap_or_default().to_string_lossy());
    let folder = tempfile::Builder::new().prefix(&prefix).suffix(".tmp").tempdir_in(parent);
    let folder = folder.map_err(io_error("write", output))?;
    let [images, work, scene, flat] = ["photographs", "colmap", "scene", "undistorted"].map(|n| folder.path().join(n));
    for path in [&images, &work, &scene] {
        std::fs::create_dir(path).map_err(io_error("create", path))?;
    }
    let processes = Processes { folder: folder.path(), stop };
    let colmap = Colmap::open(&images, &work, &processes)?;

    let (prepared, mut unregistered) = match &files {
        Some(files) => {
            progress(&format!("reading {} photographs", files.len()));
            photographs::prepare(files, &images, &processes)?
        }
        None => {
            progress("choosing sharp frames");
            (video::frames(source, options.frames, &images, &processes)?, Vec::new())
        }
    };
    let total = prepared.len() + unregistered.len();
    if prepared.len() < 2 {
        return Err(CaptureError::Input(few(source, prepared.len(), &unregistered)));
    }
    progress(&format!("extracting features of {} images", prepared.len()));
    for (number, group) in Group::of(&prepared).iter().enumerate() {
        colmap.extract(group, number)?;
    }
    let neighbors = options.matcher.map_or(files.is_none() && prepared.len() > ALL_PAIRS, |m| m == Matcher::Sequential);
    let (pairs, matcher) = if neighbors { (Pairs::Neighbors, "sequential") } else { (Pairs::All, "exhaustive") };
    progress(&format!("matching features ({matcher})"));
    colmap.match_features(pairs)?;
    progress("estimating cameras");
    let models = colmap.reconstruct()?;
    let Some((model_folder, model)) = models.first().filter(|(_, model)| model.images.len() >= 2) else {
        return Err(CaptureError::Input(format!(
            "COLMAP registered none of the {} images of {}: their views share too few features; take overlapping, sharp \
             photographs of a scene with texture, from different places",
            prepared.len(),
            source.display()
        )));
    };
    unregistered.extend(missing(&prepared, &models));
    progress(&format!("removing lens distortion of {} images", model.images.len()));
    colmap.undistort(model_folder, &flat)?;
    processes.check()?;

    let sparse = scene.join("sparse");
    std::fs::create_dir(&sparse).map_err(io_error("create", &sparse))?;
    for (from, to) in [("images", scene.join("images")), ("sparse", sparse.join("0"))] {
        let from = flat.join(from);
        std::fs::rename(&from, &to).map_err(io_error("move", &from))?;
    }
    let captured = Captured {
        format: "sgs-capture-1",
        source: source.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        photographs: total,
        registered: model.images.len(),
        unregistered,
        points: model.points,
        matcher,
        colmap: colmap.version.clone(),
        seconds: begun.elapsed().as_secs_f64(),
    };
    let text = serde_json::to_string_pretty(&captured).unwrap_or_default();
    atomic_write(&scene.join("capture.json"), |file| writeln!(file, "{text}"))?;
    // What training cannot open is not published.
    Scene::open(&scene, &SceneOptions::default())?;
    processes.check()?;
    // An empty directory gives way.
    std::fs::rename(&scene, output).map_err(io_error("write", output))?;
    Ok(captured)
}

/// Returns the photographs of a folder; `None` for a video.
fn input(source: &Path) -> Result<Option<Vec<PathBuf>>> {
    let shown = source.display();
    if source.is_dir() {
        return photographs::list(source).map(Some);
    }
    if !source.exists() {
        return Err(CaptureError::Input(format!("{shown} does not exist; give a folder of photographs, or a video")));
    }
    if photographs::is_photograph(source) {
        return Err(CaptureError::Input(format!("{shown} is one photograph; give the folder with all of them")));
    }
    Ok(None)
}

/// Describes a source with too few readable images.
fn few(source: &Path, count: usize, unreadable: &[Unregistered]) -> String {
    let shown = source.display();
    match unreadable.first() {
        Some(Unregistered { file, reason }) => format!(
            "{shown} holds {count} readable photographs and {} that cannot be read ({file}: {reason}); cameras need two or more",
            unreadable.len()
        ),
        None => format!("{shown} gives {count} images; cameras need two or more"),
    }
}

/// Returns the images that the first model lacks.
fn missing(prepared: &[Prepared], models: &[(PathBuf, ColmapModel)]) -> Vec<Unregistered> {
    let mut counts = HashMap::new();
    for (_, model) in models.iter().rev() {
        counts.extend(model.images.iter().map(|name| (name.as_str(), model.images.len())));
    }
    let first: HashSet<&str> =
        models.first().into_iter().flat_map(|(_, model)| &model.images).map(String::as_str).collect();
    let lacks = prepared.iter().filter(|image| !first.contains(image.name.as_str()));
    let reason = |image: &Prepared| match counts.get(image.name.as_str()) {
        Some(count) => format!("it belongs to {count} images that overlap with none of the others"),
        None => "too few of its features match other images".to_owned(),
    };
    lacks.map(|image| Unregistered { file: image.file.clone(), reason: reason(image) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_other_models_are_described() {
        let image = |name: &str| Prepared {
            file: name.to_uppercase(),
            name: name.into(),
            size: (1, 1),
            focal: None,
            camera: String::new(),
        };
        let model = |names: &[&str]| ColmapModel { images: names.iter().map(|n| (*n).into()).collect(), points: 1 };
        let models = [("0".into(), model(&["a", "b", "c"])), ("1".into(), model(&["c", "d"]))];
        let found = missing(&["a", "b", "c", "d", "e"].map(image), &models);
        assert_eq!(found.iter().map(|u| u.file.as_str()).collect::<Vec<_>>(), ["D", "E"]);
        assert_eq!(found[0].reason, "it belongs to 2 images that overlap with none of the others");
        assert_eq!(found[1].reason, "too few of its features match other images");
    }

    #[test]
    fn wrong_sources_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let fail = |name: &str| input(&folder.path().join(name)).unwrap_err().to_string();
        std::fs::write(folder.path().join("a.jpg"), "").unwrap();
        std::fs::write(folder.path().join("a.mp4"), "").unwrap();
        assert!(fail("none").ends_with("none does not exist; give a folder of photographs, or a video"));
        assert!(fail("a.jpg").ends_with("a.jpg is one photograph; give the folder with all of them"));
        assert_eq!(input(&folder.path().join("a.mp4")).unwrap(), None);
        assert_eq!(input(folder.path()).unwrap().unwrap().len(), 1);
        let unreadable = [Unregistered { file: "x.jpg".into(), reason: "damaged".into() }];
        assert!(few(Path::new("p"), 1, &unreadable).contains("1 that cannot be read (x.jpg: damaged); cameras need"));
    }
}

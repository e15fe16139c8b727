//! Opened scene directory.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glam::DVec3;
use rayon::prelude::*;

use crate::camera::NEAR;
use crate::depth::DepthDefinition;
use crate::error::{Result, SceneError};
use crate::exposure;
use crate::image::{Image, turning_orientation};
use crate::mask_use::MaskUse;
use crate::noise::Noise;
use crate::points::{PointCloud, RandomBox, Tracks};
use crate::prior_settings::PriorSettings;
use crate::reader::{self, Frame, Layout};
use crate::split::Split;
use crate::split_rule::SplitRule;
use crate::unit::Unit;
use crate::view::{LoadOptions, View};

/// Options for opening a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneOptions {
    /// Split into training and test views.
    pub split: SplitRule,
    /// Number of training views, spread evenly; all if `None`.
    pub views: Option<usize>,
    /// Factor on the image size, above 0 and at most 1.
    pub scale: f64,
    /// Factor on linear (EXR) images before clipping and encoding. `None` chooses the factor from the training views.
    pub exposure: Option<f32>,
    /// Background color of PNG images with alpha, display-referred.
    pub background: [f32; 3],
    /// Use of the masks of valid pixels that the data set has.
    pub masks: MaskUse,
    /// Number of random points for scenes without points. Clamped to 100 to 10 million.
    pub random_points: usize,
    /// Seed of the random points.
    pub seed: u64,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            split: SplitRule::Auto,
            views: None,
            scale: 1.0,
            exposure: None,
            background: [0.0; 3],
            masks: MaskUse::Valid,
            random_points: 100_000,
            seed: 0,
        }
    }
}

impl SceneOptions {
    fn check(&self) -> Result<()> {
        let fail = |option, value: String, expected| Err(SceneError::Option { option, value, expected });
        if self.views == Some(0) {
            return fail("--views", "0".into(), "there must be at least one training view");
        }
        if !(self.scale > 0.0 && self.scale <= 1.0) {
            return fail("--scale", self.scale.to_string(), "the factor must be above 0 and at most 1");
        }
        if let Some(exposure) = self.exposure
            && !(exposure.is_finite() && exposure > 0.0)
        {
            return fail("exposure", exposure.to_string(), "the exposure must be a positive number");
        }
        Ok(())
    }
}

/// Scene: views, their split, and initial points. Images, priors and ground truth are loaded from disk on request.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Scene directory.
    pub root: PathBuf,
    /// Layout of the directory.
    pub layout: Layout,
    /// All views, in natural order of their names: digits compare by value.
    pub views: Vec<View>,
    /// Split of the views into training and test views.
    pub split: Split,
    /// Initial points; never empty.
    pub points: PointCloud,
    /// Whether the points are random because the scene has none.
    pub points_are_random: bool,
    /// Warnings for the user, one sentence each.
    pub warnings: Vec<String>,
    /// Options of the scene; `exposure` is the applied factor.
    pub options: SceneOptions,
    pub(crate) prior_settings: PriorSettings,
    pub(crate) depth_definition: OnceLock<Option<DepthDefinition>>,
    pub(crate) noise: Noise,
    pub(crate) extent: f64,
    /// Length of the unit of the cameras, in the units of the scene's files.
    pub(crate) length: f64,
}

impl Scene {
    /// Opens a scene directory.
    ///
    /// Reads every image's header and compares its size with the camera. Pixels are decoded only to choose the exposure
    /// of linear images.
    pub fn open(path: &Path, options: &SceneOptions) -> Result<Self> {
        options.check()?;
        let root = reader::scene_root(path);
        let path = root.as_path();
        let layout = reader::recognize(path)?;
        let split_file = match &options.split {
            SplitRule::File(file) => Some(file.as_path()),
            _ => None,
        };
        let found = reader::read(path, layout, split_file)?;
        let reader::Found { mut frames, missing, points, tracks, mut warnings, own_split } = found;
        frames.sort_by_cached_key(|frame| natural_key(&frame.camera.name));
        let mut places = HashMap::new();
        for frame in &frames {
            if let Some(other) = places.insert(&frame.camera.name, &frame.image) {
                let problem = format!(
                    "the images {} and {} have the same stem; splits and priors go by it, so rename one",
                    other.display(),
                    frame.image.display()
                );
                return Err(SceneError::cameras(&frame.declared_in, "", problem));
            }
        }
        frames.par_iter().try_for_each(|frame| frame.check_size())?;
        warnings.extend(orientation_warning(&frames));
        frames.iter_mut().for_each(|frame| frame.beside.inverted = options.masks == MaskUse::Inverted);
        let mut views: Vec<View> = frames.into_iter().map(|frame| View::new(frame, options.scale)).collect();
        let split = split_of(path, &views, (&missing, own_split), options, &mut warnings)?;
        warnings.extend(coverage_warning(&views));
        let points = match tracks.filter(|tracks| !tracks.is_empty()) {
            Some(tracks) => points.map(|points| seen_points(points, &tracks, &split, &views, &mut warnings)),
            None => points,
        };

        let cameras = || split.train.iter().filter_map(|&i| views.get(i)).map(|view| &view.camera);
        let centers: Vec<DVec3> = cameras().map(|camera| camera.position()).collect();
        let extent = extent_of(&centers, points.as_ref());
        let points_are_random = points.is_none();
        let near = NEAR * Unit::of_extent(extent).length();
        views.iter_mut().for_each(|view| view.camera.near = near);
        let mut options = options.clone();
        if options.exposure.is_none() {
            let train: Vec<&View> = split.train.iter().filter_map(|&i| views.get(i)).collect();
            let chosen = exposure::choose(&train)?.unwrap_or(1.0);
            if chosen != 1.0 {
                warnings.push(format!(
                    "the linear images are exposed by {chosen}, chosen from the training views; set exposure to choose \
                     another"
                ));
            }
            options.exposure = Some(chosen);
        }
        let mut scene = Self {
            root: path.to_path_buf(),
            layout,
            views,
            split,
            points: points.unwrap_or_default(),
            points_are_random,
            warnings,
            options,
            prior_settings: PriorSettings::read(path)?,
            depth_definition: OnceLock::new(),
            noise: Noise::default(),
            extent,
            length: 1.0,
        };
        if scene.points_are_random {
            let (count, seed) = (scene.options.random_points.clamp(100, 10_000_000), scene.options.seed);
            let of_depth = scene.depth_points(count, seed)?;
            scene.points_are_random = of_depth.is_none();
            scene.points = of_depth.unwrap_or_else(|| scene.random_points(count, seed));
        }
        Ok(scene)
    }

    /// Returns random points in the part of space that training views may show.
    fn random_points(&self, count: usize, seed: u64) -> PointCloud {
        let cameras = || self.split.train.iter().filter_map(|&i| self.views.get(i)).map(|view| &view.camera);
        let seen = if self.layout == Layout::Blender { RandomBox::looked_at(cameras()) } else { None };
        let seen = seen.or_else(|| RandomBox::around(cameras(), self.extent));
        seen.map(|seen| seen.sample(count, seed)).unwrap_or_default()
    }

    /// Returns warnings for training from the scene's points, one sentence each. Evaluation of a run does not need
    /// them.
    pub fn start_warnings(&self) -> Result<Vec<String>> {
        let mut warnings = Vec::new();
        if self.points_are_random {
            let n = self.points.len();
            warnings.push(format!("{} has no point cloud; starting from {n} random points", self.root.display()));
        }
        // Only the first image is checked, so that opening a scene decodes a single image. Blender scenes of single
        // objects are transparent by design.
        let first = self.split.train.first().filter(|_| self.layout != Layout::Blender);
        let first = first.and_then(|&i| self.views.get(i));
        if let Some(view) = first
            && let Some(share) = view.transparent_share()?
        {
            warnings.push(format!(
                "{} is transparent in {:.0} % of its pixels, which are trained as the color geometry.background; set that \
                 color, or use images without transparency",
                view.image_path.display(),
                100.0 * share
            ));
        }
        if self.options.masks != MaskUse::Ignored
            && let Some(view) = self.split.train.first().and_then(|&i| self.views.get(i))
            && let Some(mask) = view.stored_mask()?
        {
            let valid = mask.data.iter().filter(|v| **v > 0.5).count() as f64 / mask.data.len().max(1) as f64;
            if valid < 0.5 {
                let (out, inverse) = match self.options.masks {
                    MaskUse::Inverted => ("", "true"),
                    _ => ("not ", "\"inverted\""),
                };
                warnings.push(format!(
                    "the mask of {} leaves out {:.0} % of its pixels, those that are {out}white; masks = {inverse} leaves out the \
                     others",
                    view.image_path.display(),
                    100.0 * (1.0 - valid)
                ));
            }
        }
        Ok(warnings)
    }

    /// Returns a view by its index.
    pub fn view(&self, index: usize) -> Result<&View> {
        self.views.get(index).ok_or_else(|| SceneError::Data {
            what: "the scene",
            problem: format!("there is no view {index}; there are {}", self.views.len()),
        })
    }

    /// Returns 1.1 times the largest distance of a training camera from their mean.
    ///
    /// If all cameras share one position (one view, a panorama), the extent is half the median distance from them to
    /// the scene's points. If the points are random, the extent is then 1.
    pub fn extent(&self) -> f64 {
        self.extent
    }

    /// Returns the scene with its image size scaled by `share`. `share` is above 0 and at most 1.
    #[must_use]
    pub fn scaled(&self, share: f64) -> Scene {
        let mut scene = self.clone();
        scene.options.scale *= share;
        let scale = scene.options.scale;
        scene.views = scene.views.into_iter().map(|view| view.at_scale(scale)).collect();
        scene
    }

    /// Returns the unit in which the scene is computed.
    pub fn unit(&self) -> Unit {
        Unit::of_extent(self.extent())
    }

    /// Returns the scene with lengths converted to a unit. Ground truth keeps the units of its files.
    #[must_use]
    pub fn in_unit(&self, unit: Unit) -> Scene {
        let mut scene = self.clone();
        for view in &mut scene.views {
            view.camera = view.camera.in_unit(unit);
        }
        scene.points.positions.iter_mut().for_each(|p| *p = unit.place(*p));
        scene.extent /= unit.length();
        scene.length *= unit.length();
        scene
    }

    /// Returns the scene with noise on its inputs. Noise applies to the points, the normal and semantic priors, and the
    /// cameras of training views whose poses are not learned. The extent of the scene is unchanged.
    #[must_use]
    pub fn disturbed(&self, noise: &Noise) -> Scene {
        let mut scene = self.clone();
        scene.noise = *noise;
        let extent = self.extent();
        noise.move_points(&mut scene.points.positions, extent);
        if noise.rotations > 0.0 || noise.translations > 0.0 {
            for &i in &self.split.train {
                let view = &mut scene.views[i];
                if !view.learned_pose {
                    view.camera = noise.moved(&view.camera, i, extent);
                }
                view.stored_camera = noise.moved(&view.stored_camera, i, extent);
            }
        }
        scene
    }

    /// Loads the image of a view with the scene's exposure, as [`View::load_image`].
    pub fn load_image(&self, view: usize) -> Result<Image> {
        self.view(view)?.load_image(&self.load_options())
    }

    /// Returns the load options of the scene's images.
    pub fn load_options(&self) -> LoadOptions {
        LoadOptions { exposure: self.exposure(), background: self.options.background }
    }

    /// Loads the mask of a view, as [`View::load_mask`]. Returns `None` if all pixels are valid or masks are disabled.
    pub fn load_mask(&self, view: usize) -> Result<Option<Image>> {
        let view = self.view(view)?;
        if self.options.masks == MaskUse::Ignored { Ok(None) } else { view.load_mask() }
    }

    /// Returns the exposure factor of linear images.
    pub fn exposure(&self) -> f32 {
        self.options.exposure.unwrap_or(1.0)
    }

    /// Loads the images of all training views, in the order of [`Split::train`].
    pub fn load_train_images(&self) -> Result<Vec<Image>> {
        self.split.train.par_iter().map(|&i| self.load_image(i)).collect()
    }
}

/// Returns a warning about EXIF orientations; `None` if all images are upright.
fn orientation_warning(frames: &[Frame]) -> Option<String> {
    let turned = |frame: &&Frame| turning_orientation(&frame.image).is_some();
    let all: Vec<&Frame> = frames.par_iter().filter(turned).collect();
    let first = all.first()?;
    Some(format!(
        "{} images have an EXIF orientation, which is ignored, because cameras refer to the stored pixels (the first is {})",
        all.len(),
        first.image.display()
    ))
}

/// Returns the sort key of a name in natural order. Runs of digits compare by value, so 9 comes before 10.
fn natural_key(name: &str) -> (Vec<(String, u128)>, String) {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let (text, after) = rest.split_at(rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len()));
        let (digits, after) = after.split_at(after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len()));
        // A number that overflows is not a counter; the whole name then decides.
        key.push((text.to_string(), digits.parse().unwrap_or(0)));
        rest = after;
    }
    (key, name.to_string())
}

fn split_of(
    root: &Path,
    views: &[View],
    (missing, own_split): (&[String], bool),
    options: &SceneOptions,
    warnings: &mut Vec<String>,
) -> Result<Split> {
    let names: Vec<&str> = views.iter().map(|view| view.camera.name.as_str()).collect();
    let path = root.join("split.json");
    let mut split = if let Some(split) = Split::by_rule(&options.split, root, &names, missing)? {
        split
    } else if path.is_file() {
        Split::read(&path, &names, missing)?
    } else if own_split {
        let (test, train) = (0..views.len()).partition(|&i| views[i].beside.test == Some(true));
        Split { train, test }
    } else {
        Split::every_eighth(views.len())
    };
    if split.train.is_empty() {
        if own_split {
            let problem = "all of the views are test views; a scene needs at least one training view";
            return Err(SceneError::split(root, problem));
        }
        let problem = format!(
            "no training view is left, because without split.json every 8th of the {} views is a test view; add views or \
             a split.json",
            views.len()
        );
        return Err(SceneError::split(root, problem));
    }
    if let Some(count) = options.views {
        let had = split.train.len();
        if !split.spread(count) {
            warnings.push(format!("--views asks for {count} training views, but there are {had}; all are taken"));
        }
    }
    Ok(split)
}

/// Returns the points that at least two training views see; all if none remains. Adds a warning with the number of
/// excluded points.
fn seen_points(
    points: PointCloud,
    tracks: &Tracks,
    split: &Split,
    views: &[View],
    warnings: &mut Vec<String>,
) -> PointCloud {
    let training = split.train.iter().filter_map(|&i| views.get(i)).map(|view| view.camera.name.as_str());
    let retained = tracks.seen_twice(&training.collect());
    let (count, left) = (points.len(), retained.iter().filter(|retained| **retained).count());
    if left == 0 {
        warnings.push(format!(
            "fewer than two training views see any of the {count} points; training starts from all of them; train with more \
             views"
        ));
        return points;
    }
    if left < count {
        let out = count - left;
        warnings.push(format!(
            "fewer than two training views see {out} of the {count} points; training starts from the other {left}"
        ));
    }
    points.filtered(&retained)
}

/// Returns a warning if undistortion leaves more than 1 % of an image uncovered.
fn coverage_warning(views: &[View]) -> Option<String> {
    let worst = views
        .par_iter()
        .filter(|view| !view.distortion.is_none())
        .map(|view| {
            // A small image estimates the fraction accurately enough.
            let mut small = view.clone();
            small.stored_camera = view.stored_camera.scaled(64, 64);
            small.camera = small.stored_camera.clone();
            let seen = small.coverage().map_or(1.0, |c| c.data.iter().sum::<f32>() / c.data.len() as f32);
            (1.0 - seen, view.camera.name.as_str())
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    (worst.0 > 0.01).then(|| {
        let percent = 100.0 * worst.0;
        format!("undistorting \"{}\" leaves {percent:.1} % of its pixels unseen; they repeat the border", worst.1)
    })
}

fn extent_of(centers: &[DVec3], points: Option<&PointCloud>) -> f64 {
    if centers.is_empty() {
        return 1.0;
    }
    let mean = centers.iter().sum::<DVec3>() / centers.len() as f64;
    let radius = centers.iter().map(|c| c.distance(mean)).fold(0.0, f64::max);
    let distance = points.and_then(|points| {
        let mut all: Vec<f64> = points.positions.iter().map(|p| mean.distance(DVec3::from(p.map(f64::from)))).collect();
        let middle = all.len() / 2;
        (!all.is_empty()).then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1)
    });
    let distance = distance.filter(|d| *d > 0.0 && d.is_finite());
    match distance {
        Some(distance) if radius > 1e-3 * distance => 1.1 * radius,
        Some(distance) => 0.5 * distance,
        None if radius > 1e-9 => 1.1 * radius,
        None => 1.0,
    }
}

#[cfg(test)]
mod tests;

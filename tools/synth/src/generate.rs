//! Generates a whole scene directory.
//!
//! Builds the room, places cameras, sets the exposure, renders, simulates priors, and writes all files.

use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use glam::Vec3;
use serde_json::json;

use crate::error::SynthError;
use crate::expose;
use crate::options::SynthOptions;
use crate::output::layout::{self, Names};
use crate::output::lights::{self, Relighting};
use crate::output::stage::Stage;
use crate::output::{exr, meta, npy, ply, view};
use crate::points;
use crate::priors::{maps, masks, semantic};
use crate::rng;
use crate::scene::classes::CLASSES;
use crate::scene::{MAX_GROUPS, Scene};
use crate::trace::camera::Camera;
use crate::trace::denoise::{self, Image};
use crate::trace::film::Film;
use crate::trace::path::PathOptions;
use crate::trace::render::render;
use crate::views;

/// Summary of a generated scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Number of training views.
    pub train_views: usize,
    /// Number of test views.
    pub test_views: usize,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Number of triangles in the scene.
    pub triangles: usize,
    /// Number of lights in the scene.
    pub lights: usize,
    /// Number of objects with a mask of their own.
    pub instances: usize,
    /// Number of points in `points.ply`. Below the requested number when views hardly overlap.
    pub points: usize,
    /// Names of the relit sets under `gt/relit`.
    pub relit: Vec<String>,
    /// Fraction of the images' values that clip at exposure 1.
    pub clipped: f32,
    /// Mean display value of the images.
    pub mean: f32,
    /// Elapsed wall-clock seconds.
    pub seconds: f64,
}

/// Generates the scene directory `out`.
///
/// `out` must not exist or must be empty; with [`SynthOptions::replace`] it may also be a scene. `progress` receives
/// the number of finished and of total units of work. The finished number never decreases. Any thread may call
/// `progress`. The same options give the same bytes for any number of threads.
///
/// # Errors
///
/// Options out of range, an output path that may not be written, and failures of the file system.
pub fn generate(
    out: &Path,
    options: &SynthOptions,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Summary, SynthError> {
    options.validate()?;
    let started = Instant::now();
    let stage = Stage::open(out, options.replace)?;
    let mut scene = Scene::build(options.scene, options.seed);
    let views = views::place(&scene, options);
    expose::expose(&mut scene, &views.train, options.seed);
    let relightings = if options.relit { lights::relightings(&scene) } else { Vec::new() };
    let rooms = relightings.iter().filter(|r| r.room.is_some()).count();
    let renders = options.views + options.test_views * (1 + rooms);
    let progress = Progress::new((renders * options.height) as u64, progress);
    let embeddings = semantic::embeddings();
    let job = Job {
        scene: &scene,
        options,
        stage: &stage,
        embeddings: &embeddings,
        relightings: &relightings,
        progress: &progress,
    };
    let mut images = Vec::with_capacity(options.views);
    let mut tally = Tally::default();
    for (index, camera) in views.train.iter().chain(&views.test).enumerate() {
        let train = index < options.views;
        let image = job.view(index, camera, train)?;
        tally.add(&image);
        if train {
            images.push(image);
        }
    }
    let points = points::choose(&scene, &views.train, &images, options.points, options.seed);
    stage.write("points.ply", &ply::encode(&points))?;
    layout::cameras(&stage, options.layout, &views)?;
    stage.write("scene.json", &meta::text(&meta::scene(&scene, options)))?;
    job.shared_files()?;
    stage.commit()?;
    Ok(Summary {
        train_views: options.views,
        test_views: options.test_views,
        width: options.width,
        height: options.height,
        triangles: scene.surfaces.len(),
        lights: scene.lights.len(),
        instances: scene.instances.len() - 1,
        points: points.len(),
        relit: relightings.iter().map(|r| r.name.to_owned()).collect(),
        clipped: tally.clipped / tally.values.max(1.0),
        mean: tally.sum / tally.values.max(1.0),
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// Data shared by all views.
struct Job<'a> {
    scene: &'a Scene,
    options: &'a SynthOptions,
    stage: &'a Stage,
    embeddings: &'a [Vec<f32>],
    relightings: &'a [Relighting],
    progress: &'a Progress<'a>,
}

impl Job<'_> {
    /// Renders one view and writes its files. Returns its linear image.
    fn view(&self, index: usize, camera: &Camera, train: bool) -> Result<Image, SynthError> {
        let (options, stage) = (self.options, self.stage);
        let film = self.film(self.scene, camera, &[options.seed, 0x5a11, index as u64]);
        let footprint = 1.0 / camera.focal;
        let image = denoise::image(&film, footprint, &[Vec3::ONE; MAX_GROUPS], options.denoise);
        let names = Names::new(options.layout, index, options.views);
        let stem = names.stem();
        names.image(stage, &film, &image)?;
        view::truth(stage, &names, &film)?;
        let number = index as u64;
        let maps = maps::imitate(&film, &image, camera, options.seed, number);
        let regions = masks::imitate(&film, options.seed, number);
        view::priors(stage, &stem, &film, &maps, &regions)?;
        if train {
            let grid = semantic::Grid { cell: options.semantic_cell, wrong: options.semantic_wrong };
            let features = semantic::imitate(&film, self.embeddings, grid, options.seed, number);
            view::semantic(stage, &stem, &features)?;
        } else {
            for relighting in self.relightings {
                let other =
                    relighting.room.as_ref().map(|room| self.film(room, camera, &[options.seed, 0xadd, index as u64]));
                let film = other.as_ref().unwrap_or(&film);
                let relit = denoise::image(film, footprint, &relighting.weights, options.denoise);
                names.relit(stage, relighting.name, film, &relit)?;
            }
        }
        Ok(image)
    }

    /// Renders a view of a scene. Samples depend on the key alone.
    fn film(&self, scene: &Scene, camera: &Camera, key: &[u64]) -> Film {
        let samples = self.options.samples_per_pixel;
        render(scene, camera, rng::key(key), samples, &PathOptions::default(), &|| self.progress.advance())
    }

    /// Writes the files that belong to no single view.
    fn shared_files(&self) -> Result<(), SynthError> {
        let stage = self.stage;
        let frame = json!({ "normal": { "frame": "camera-opengl" } });
        stage.write("priors/priors.json", &meta::text(&frame))?;
        let labels = meta::labels(semantic::DIM, self.options.semantic_cell);
        stage.write("priors/semantic/labels.json", &meta::text(&labels))?;
        stage.write("gt/semantic/labels.json", &meta::text(&json!({ "labels": CLASSES })))?;
        let flat: Vec<u8> = self.embeddings.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let shape = [self.embeddings.len(), semantic::DIM];
        let table = npy::encode("<f4", &shape, &flat);
        stage.write("priors/semantic/text_embeddings.npy", &table)?;
        let lights = lights::describe(self.scene, self.relightings);
        stage.write("gt/lights.json", &meta::text(&lights))?;
        for relighting in self.relightings {
            let about = json!({
                "lighting": relighting.name,
                "group_weights": lights["light_groups_weights"][relighting.name],
                "lights": lights["relight"][relighting.name],
                "note": "group_weights are factors on the training lighting; materials are unchanged; a light that \
                         training lacks is in lights alone",
            });
            let path = format!("gt/relit/{}.json", relighting.name);
            stage.write(path, &meta::text(&about))?;
        }
        let own = (lights::ENVIRONMENT, self.scene);
        let others = self.relightings.iter().filter_map(|r| Some((r.environment.as_str(), r.room.as_ref()?)));
        let mut written = Vec::new();
        for (name, scene) in [own].into_iter().chain(others) {
            if scene.sky.mean() > 0.0 && !written.contains(&name) {
                let (width, height) = (256, 128);
                exr::rgb(&stage.file(format!("gt/{name}"))?, width, height, &scene.sky.map(width, height))?;
                written.push(name);
            }
        }
        Ok(())
    }
}

/// Sums over the values of all images.
#[derive(Default)]
struct Tally {
    values: f32,
    sum: f32,
    clipped: f32,
}

impl Tally {
    fn add(&mut self, image: &Image) {
        let (mut sum, mut clipped) = (0.0, 0usize);
        for value in image.iter().flat_map(|c| c.to_array()) {
            sum += crate::color::encode(value);
            clipped += usize::from(value > 1.0);
        }
        self.values += 3.0 * image.len() as f32;
        self.sum += sum;
        self.clipped += clipped as f32;
    }
}

/// Counter of finished units of work that reports in ascending order.
struct Progress<'a> {
    done: Mutex<u64>,
    total: u64,
    report: &'a (dyn Fn(u64, u64) + Sync),
}

impl<'a> Progress<'a> {
    fn new(total: u64, report: &'a (dyn Fn(u64, u64) + Sync)) -> Self {
        report(0, total);
        Self { done: Mutex::new(0), total, report }
    }

    fn advance(&self) {
        // Reports while holding the lock, so that no caller sees the count decrease.
        let mut done = self.done.lock().unwrap_or_else(|e| e.into_inner());
        *done += 1;
        (self.report)(*done, self.total);
    }
}

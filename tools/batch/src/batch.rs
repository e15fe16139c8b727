//! Runs of a batch: each scene with each variant and each seed.

use crate::error::{Result, failed, wrong};
use crate::identity::Digest;
use crate::manifest::{Limits, Manifest, Stage, Variant, name_of};
use crate::records::{Record, Records};
use sgs_config::Settings;
use sgs_scene::Scene;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Run of a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Name of the scene.
    pub scene: String,
    /// Scene directory.
    pub scene_path: PathBuf,
    /// Name of the variant.
    pub variant: String,
    /// Seed.
    pub seed: u64,
    /// File with the variant's settings, relative to the directory of the batch.
    pub config: PathBuf,
    /// Run directory, if it is another than that of [`Run::path`]. Relative to the directory of the batch.
    pub directory: Option<PathBuf>,
    /// Hash of settings, scene and program version.
    pub identity: String,
    /// Hash of what its forecast depends on. All seeds have the same.
    pub plan_identity: String,
    /// Estimated cost: pixels of the training views times steps. 0 if the scene cannot be opened.
    pub cost: u128,
}

impl Run {
    /// Returns the name: scene, variant and seed.
    pub fn name(&self) -> String {
        format!("{}/{}/seed{}", self.scene, self.variant, self.seed)
    }

    /// Returns the name for files in a folder of all runs.
    ///
    /// Names of variants have no dots, so that two runs never share a key.
    pub fn key(&self) -> String {
        format!("{}.{}.seed{}", self.scene, self.variant, self.seed)
    }

    /// Returns a path of the run: the run directory without an extension, the log or the record with one.
    pub fn path(&self, root: &Path, extension: &str) -> PathBuf {
        if let Some(directory) = self.directory.as_ref().filter(|_| extension.is_empty()) {
            return root.join(directory);
        }
        let folder = root.join("runs").join(&self.scene).join(&self.variant);
        let name = format!("seed{}", self.seed);
        folder.join(if extension.is_empty() { name } else { format!("{name}.{extension}") })
    }
}

/// Static part of the runs: those whose position has a remainder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Index from 0.
    pub index: usize,
    /// Number of shards.
    pub count: usize,
}

impl Shard {
    /// Parses `I/N`, where I is 1 to N.
    ///
    /// # Errors
    /// A sentence that describes the expected format.
    pub fn parse(text: &str) -> std::result::Result<Shard, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse::<usize>().ok()?, n.parse().ok()?)));
        match parts {
            Some((i, count)) if i >= 1 && i <= count => Ok(Shard { index: i - 1, count }),
            _ => Err(format!("\"{text}\" is no shard; write I/N with I from 1 to N, as 1/4")),
        }
    }
}

/// Settings of a variant, and the file that they are written to.
#[derive(Clone, Debug, PartialEq)]
struct Config {
    path: PathBuf,
    text: String,
    settings: Settings,
}

/// All runs of a manifest.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Runs in the order of the manifest: by scene, then variant, then seed.
    pub runs: Vec<Run>,
    /// Settings of each variant.
    configs: Vec<Config>,
    /// Stages to train.
    pub stage: Stage,
    /// Whether to evaluate each run after training.
    pub evaluate: bool,
    /// Limits of each run.
    pub limits: Limits,
}

impl Batch {
    /// Expands a manifest. Reads all scenes to hash them. `version`: that of the program.
    ///
    /// `root`: directory of the batch. Workers that start together over it share the reading. Without it nothing is
    /// written.
    ///
    /// # Errors
    /// If a scene cannot be read, the directory cannot be written, or settings cannot be written as TOML.
    pub fn new(manifest: &Manifest, version: &str, root: Option<&Path>, stop: &AtomicBool) -> Result<Batch> {
        let mut configs = Vec::new();
        for variant in &manifest.variants {
            let text = config_text(&variant.settings)?;
            let mut digest = Digest::new();
            digest.add(text.as_bytes());
            // The hash keeps settings apart that have one name in two versions of a manifest.
            let file = format!("{}.{:.8}.toml", variant.name, digest.to_string());
            let settings = variant.settings.clone();
            configs.push(Config { path: Path::new("variants").join(file), text, settings });
        }
        let keys: Vec<String> = configs.iter().map(|config| cost_key(version, manifest.stage, &config.text)).collect();
        let records = records(manifest, &keys, root, stop)?;
        let mut runs = Vec::new();
        for (path, record) in manifest.scenes.iter().zip(&records) {
            let Some(scene) = name_of(path) else { return Err(wrong(path, "it has no name")) };
            // A scene without a record was left out by the stop. The queue then starts nothing.
            let digest = record.as_ref().and_then(Record::digest).unwrap_or_default();
            for ((variant, config), key) in manifest.variants.iter().zip(&configs).zip(&keys) {
                let known = record.as_ref().and_then(|r| r.cost(key));
                let cost = known.unwrap_or_else(|| cost(path, &variant.settings, manifest.stage));
                let plan_identity = identity(version, &config.text, manifest.stage, None, &digest);
                for seed in &manifest.seeds {
                    runs.push(Run {
                        scene: scene.to_owned(),
                        scene_path: path.clone(),
                        variant: variant.name.clone(),
                        seed: *seed,
                        config: config.path.clone(),
                        directory: None,
                        identity: identity(version, &config.text, manifest.stage, Some(*seed), &digest),
                        plan_identity: plan_identity.clone(),
                        cost,
                    });
                }
            }
        }
        let Manifest { stage, evaluate, limits, .. } = *manifest;
        Ok(Batch { runs, configs, stage, evaluate, limits })
    }

    /// Writes the settings of the variants below the directory of a batch. Leaves equal files as they are.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write_configs(&self, root: &Path) -> Result<()> {
        for Config { path, text, .. } in &self.configs {
            write_if_changed(&root.join(path), text)?;
        }
        Ok(())
    }

    /// Returns the settings of a run, without scene and seed.
    pub(crate) fn settings(&self, run: &Run) -> Option<&Settings> {
        self.configs.iter().find(|config| config.path == run.config).map(|config| &config.settings)
    }

    /// Returns the indices of a shard's runs, most expensive first by the estimate.
    pub fn order(&self, shard: Option<Shard>) -> Vec<usize> {
        let Shard { index, count } = shard.unwrap_or(Shard { index: 0, count: 1 });
        let mut order: Vec<usize> = (0..self.runs.len()).filter(|i| i % count == index).collect();
        most_expensive_first(&mut order, |i| self.runs[i].cost);
        order
    }
}

/// Sorts indices of runs by descending cost. Equal costs keep their order.
///
/// Long runs at the end would leave other devices idle.
pub fn most_expensive_first(order: &mut [usize], cost: impl Fn(usize) -> u128) {
    order.sort_by_key(|i| std::cmp::Reverse(cost(*i)));
}

/// Writes a text atomically, unless the file holds it.
pub(crate) fn write_if_changed(path: &Path, text: &str) -> Result<()> {
    if std::fs::read(path).is_ok_and(|there| there == text.as_bytes()) {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed("made", folder))?;
    }
    Ok(sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?)
}

fn config_text(settings: &Settings) -> Result<String> {
    let table = settings.to_table()?;
    toml::to_string(&table)
        .map_err(|e| sgs_config::ConfigError::Format(format!("The settings cannot be written: {e}.")).into())
}

/// Returns the identity of a run, or without a seed that of its forecast.
fn identity(version: &str, settings: &str, stage: Stage, seed: Option<u64>, scene: &Digest) -> String {
    let mut digest = Digest::new();
    let (kind, seed) = seed.map_or(("sgs batch plan 1", String::new()), |seed| ("sgs batch 1", seed.to_string()));
    for field in [kind, version, settings, stage.name(), &seed, &scene.to_string()] {
        digest.field(field.as_bytes());
    }
    digest.to_string()
}

/// Returns the name under which the record of a scene has the cost of a variant.
fn cost_key(version: &str, stage: Stage, settings: &str) -> String {
    let mut digest = Digest::new();
    for field in [version, stage.name(), settings] {
        digest.field(field.as_bytes());
    }
    digest.to_string()
}

/// Reads scenes, several at once. Those that a stop left out have no record.
fn records(
    manifest: &Manifest,
    keys: &[String],
    root: Option<&Path>,
    stop: &AtomicBool,
) -> Result<Vec<Option<Record>>> {
    let scenes = &manifest.scenes;
    let shared = root.map(Records::open).transpose()?;
    let next = AtomicUsize::new(0);
    let found: Mutex<Vec<Option<Result<Record>>>> = Mutex::new(scenes.iter().map(|_| None).collect());
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(scenes.len());
    let random = RandomState::new().build_hasher().finish() as usize;
    let read = |path: &Path| {
        let of = |(variant, key): (&Variant, &String)| (key.clone(), cost(path, &variant.settings, manifest.stage));
        let costs = || manifest.variants.iter().zip(keys).map(of).collect();
        let name = name_of(path).ok_or_else(|| wrong(path, "it has no name"))?;
        match &shared {
            Some(shared) => shared.record(name, path, costs),
            None => Record::read(path, costs),
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while !stop.load(Ordering::SeqCst) {
                    let i = next.fetch_add(1, Ordering::SeqCst);
                    if i >= scenes.len() {
                        break;
                    }
                    // Workers that start together read in different orders, so that each reads a part.
                    let i = scattered(i, random, scenes.len());
                    let record = read(&scenes[i]);
                    if let Ok(mut found) = found.lock() {
                        found[i] = Some(record);
                    }
                }
            });
        }
    });
    found.into_inner().unwrap_or_default().into_iter().map(Option::transpose).collect()
}

/// Returns the `i`-th of `count` indices in an order that a random number selects.
fn scattered(i: usize, random: usize, count: usize) -> usize {
    let common = |mut a: usize, mut b: usize| {
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    // A step without a common factor visits each index once.
    let first = 1 + random % count;
    let step = (first..first + count).find(|step| common(*step, count) == 1).unwrap_or(1);
    (random / count % count + i * (step % count.max(2))) % count
}

/// Estimates the cost of a run.
///
/// A scene that cannot be opened costs 0 and is tried last. Its training says what is wrong.
fn cost(path: &Path, settings: &Settings, stage: Stage) -> u128 {
    let Ok(scene) = Scene::open(path, &settings.scene_options()) else { return 0 };
    let cameras = scene.split.train.iter().filter_map(|view| scene.views.get(*view)).map(|view| &view.camera);
    let pixels: u128 = cameras.map(|c| u128::from(c.width as u64) * u128::from(c.height as u64)).sum();
    pixels * u128::from(stage.steps(settings))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a run without a scene.
    pub(crate) fn run(scene: &str, seed: u64) -> Run {
        Run {
            scene: scene.into(),
            scene_path: PathBuf::new(),
            variant: "fast".into(),
            seed,
            config: PathBuf::new(),
            directory: None,
            identity: format!("{scene}{seed}"),
            plan_identity: scene.into(),
            cost: 1,
        }
    }

    /// Returns a batch of runs without scenes.
    pub(crate) fn batch(runs: Vec<Run>) -> Batch {
        let limits = Limits { retries: 2, timeout: None, memory_budget: None };
        let config = Config { path: PathBuf::new(), text: String::new(), settings: Settings::default() };
        Batch { runs, configs: vec![config], stage: Stage::Geometry, evaluate: false, limits }
    }

    #[test]
    fn identity_depends_on_all_that_determines_the_result() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("room");
        std::fs::create_dir(&scene).unwrap();
        std::fs::write(scene.join("cameras.txt"), "one").unwrap();
        let manifest = |change: &dyn Fn(&mut Manifest)| {
            let mut manifest = Manifest {
                scenes: vec![scene.clone()],
                ignored: Vec::new(),
                variants: vec![Variant { name: "fast".into(), settings: Settings::default() }],
                seeds: vec![0],
                stage: Stage::Geometry,
                evaluate: true,
                limits: batch(Vec::new()).limits,
            };
            change(&mut manifest);
            manifest
        };
        let of = |version: &str, change: &dyn Fn(&mut Manifest)| {
            let out = folder.path().join("out");
            Batch::new(&manifest(change), version, Some(&out), &AtomicBool::new(false)).unwrap().runs[0]
                .identity
                .clone()
        };
        let base = of("1", &|_| {});
        assert_eq!(base.len(), 32);
        assert_eq!(of("1", &|m| m.limits.retries = 9), base);
        assert_eq!(of("1", &|m| m.variants[0].name = "other".into()), base);
        assert_ne!(of("2", &|_| {}), base);
        assert_ne!(of("1", &|m| m.seeds = vec![1]), base);
        assert_ne!(of("1", &|m| m.stage = Stage::All), base);
        assert_ne!(of("1", &|m| m.variants[0].settings.geometry.steps += 1), base);
        std::fs::write(scene.join("cameras.txt"), "onf").unwrap();
        assert_ne!(of("1", &|_| {}), base);
    }

    #[test]
    fn scattered_order_visits_each_index_once() {
        for count in [1, 2, 3, 4, 12, 97, 1000] {
            let orders: Vec<Vec<usize>> = [0, 1, 7, 12_345, usize::MAX]
                .iter()
                .map(|r| (0..count).map(|i| scattered(i, *r, count)).collect())
                .collect();
            for order in &orders {
                let mut sorted = order.clone();
                sorted.sort_unstable();
                assert!(sorted.into_iter().eq(0..count), "{count}: {order:?}");
            }
            assert!(count < 12 || orders[2] != orders[3]);
        }
    }

    #[test]
    fn runs_are_expanded_in_order_and_split_without_gaps() {
        let runs: Vec<Run> = (0..7).map(|seed| Run { cost: u128::from(seed % 3), ..run("a", seed) }).collect();
        let batch = batch(runs);
        assert_eq!(batch.order(None), [2, 5, 1, 4, 0, 3, 6]);
        let shards = ["1/3", "2/3", "3/3"].map(|s| batch.order(Some(Shard::parse(s).unwrap())));
        assert_eq!(shards[0], [0, 3, 6]);
        let mut all = shards.concat();
        all.sort_unstable();
        assert_eq!(all, (0..7).collect::<Vec<_>>());
        for wrong in ["0/3", "4/3", "1", "a/b", "1/0", "-1/2"] {
            assert!(Shard::parse(wrong).unwrap_err().contains("is no shard"), "{wrong}");
        }
    }
}

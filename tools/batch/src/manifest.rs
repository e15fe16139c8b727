//! Manifest of a batch: scenes, variants, seeds, stage and limits.

use crate::error::{Result, failed, wrong};
use serde::Deserialize;
use sgs_config::{Preset, Settings, overlay};
use sgs_scene::Layout;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Largest number of runs of a batch. A typing error in a list must not fill a disk.
const MOST_RUNS: usize = 1_000_000;

/// Stages that a batch trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The geometry stage.
    Geometry,
    /// The geometry stage, then the transport stage.
    Transport,
    /// All stages.
    All,
}

impl Stage {
    /// Returns the name, as the option `--stage` of `sgs train` has it.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Geometry => "geometry",
            Stage::Transport => "transport",
            Stage::All => "all",
        }
    }

    /// Returns the number of steps of its stages.
    pub fn steps(self, settings: &Settings) -> u64 {
        let (geometry, intrinsic) = (u64::from(settings.geometry.steps), u64::from(settings.intrinsic.steps));
        let transport = if settings.transport.enabled() { u64::from(settings.transport.steps) + 1 } else { 0 };
        match self {
            Stage::Geometry => geometry,
            Stage::Transport => geometry + transport,
            Stage::All => geometry + intrinsic + transport,
        }
    }
}

/// Settings under a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Name of the variant.
    pub name: String,
    /// Resolved settings, without scene and seed.
    pub settings: Settings,
}

/// Limits of each run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// How often a run that can succeed later is started again.
    pub retries: u32,
    /// Longest time of an attempt.
    pub timeout: Option<Duration>,
    /// Device memory of training in bytes.
    pub memory_budget: Option<u64>,
}

/// Manifest with its paths and settings resolved.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifest {
    /// Scene directories, in order.
    pub scenes: Vec<PathBuf>,
    /// Folders that match a pattern but hold no scene.
    pub ignored: Vec<PathBuf>,
    /// Variants, in order.
    pub variants: Vec<Variant>,
    /// Seeds, in order.
    pub seeds: Vec<u64>,
    /// Stages to train.
    pub stage: Stage,
    /// Whether to evaluate each run after training.
    pub evaluate: bool,
    /// Limits of each run.
    pub limits: Limits,
}

impl Default for Limits {
    fn default() -> Self {
        Limits { retries: 2, timeout: None, memory_budget: None }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    scenes: Vec<String>,
    #[serde(default = "one_seed")]
    seeds: Vec<u64>,
    #[serde(default = "geometry")]
    stage: String,
    #[serde(default = "yes")]
    evaluate: bool,
    #[serde(default)]
    variants: Vec<VariantTable>,
    #[serde(default)]
    limits: LimitTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VariantTable {
    name: String,
    preset: Option<String>,
    #[serde(default)]
    settings: toml::Table,
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct LimitTable {
    retries: u32,
    timeout: Option<f64>,
    memory_budget: Option<String>,
}

impl Default for LimitTable {
    fn default() -> Self {
        LimitTable { retries: Limits::default().retries, timeout: None, memory_budget: None }
    }
}

fn one_seed() -> Vec<u64> {
    vec![0]
}

fn geometry() -> String {
    "geometry".to_owned()
}

fn yes() -> bool {
    true
}

impl Manifest {
    /// Reads a manifest. Scenes are relative to its directory.
    ///
    /// # Errors
    /// If the file cannot be read, a key or a setting is wrong, or no scene matches.
    pub fn read(path: &Path) -> Result<Manifest> {
        let text = std::fs::read_to_string(path).map_err(|e| wrong(path, format!("it cannot be read: {e}")))?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Manifest::parse(&text, folder).map_err(|problem| wrong(path, problem.trim_end_matches('.')))
    }

    /// Creates the manifest of one scene, of runs that their processes evaluate.
    ///
    /// # Errors
    /// If the scene cannot be found.
    pub fn of_scene(
        scene: &Path,
        variants: Vec<Variant>,
        seeds: Vec<u64>,
        stage: Stage,
        limits: Limits,
    ) -> Result<Manifest> {
        let scenes = vec![named(scene).map_err(failed("read", scene))?];
        Ok(Manifest { scenes, ignored: Vec::new(), variants, seeds, stage, evaluate: false, limits })
    }

    fn parse(text: &str, folder: &Path) -> std::result::Result<Manifest, String> {
        let file: File = toml::from_str(text).map_err(|e| sgs_config::one_line(e.message()))?;
        let stage = match file.stage.as_str() {
            "geometry" => Stage::Geometry,
            "transport" => Stage::Transport,
            "all" => Stage::All,
            other => {
                let why = if other == "intrinsic" { ": it needs trained geometry" } else { "" };
                return Err(format!("stage is \"{other}\"{why}; use \"geometry\", \"transport\" or \"all\""));
            }
        };
        let limits = limits(&file.limits)?;
        let variants = variants(file.variants, &limits)?;
        if let Some(variant) = variants.iter().find(|v| stage == Stage::Transport && !v.settings.transport.enabled()) {
            let name = &variant.name;
            return Err(format!(
                "variant \"{name}\" has transport.surfels = 0, which leaves the stage out; use 64 or more"
            ));
        }
        unique("seeds", &file.seeds)?;
        if let Some(seed) = file.seeds.iter().find(|s| i64::try_from(**s).is_err()) {
            return Err(format!("seeds has {seed}; use at most {}", i64::MAX));
        }
        let (scenes, ignored) = scenes(&file.scenes, folder)?;
        let count = scenes.len().saturating_mul(variants.len()).saturating_mul(file.seeds.len());
        if count > MOST_RUNS {
            return Err(format!("it has {count} runs; split it into manifests of at most {MOST_RUNS}"));
        }
        Ok(Manifest { scenes, ignored, variants, seeds: file.seeds, stage, evaluate: file.evaluate, limits })
    }
}

fn unique<T: PartialEq + std::fmt::Display>(what: &str, all: &[T]) -> std::result::Result<(), String> {
    if all.is_empty() {
        return Err(format!("{what} is empty; list at least one"));
    }
    match all.iter().enumerate().find(|(i, one)| all[..*i].contains(one)) {
        Some((_, one)) => Err(format!("{what} has {one} twice; list each once")),
        None => Ok(()),
    }
}

fn limits(table: &LimitTable) -> std::result::Result<Limits, String> {
    let seconds = |s: f64| Duration::try_from_secs_f64(s).ok().filter(|d| !d.is_zero());
    let timeout = match table.timeout {
        None => None,
        Some(s) => Some(seconds(s).ok_or_else(|| format!("limits.timeout is {s}; use a number of seconds above 0"))?),
    };
    let budget = table.memory_budget.as_deref().map(sgs_config::parse_bytes).transpose();
    let memory_budget = budget.map_err(|e| format!("limits.memory_budget: {e}"))?;
    Ok(Limits { retries: table.retries, timeout, memory_budget })
}

fn variants(tables: Vec<VariantTable>, limits: &Limits) -> std::result::Result<Vec<Variant>, String> {
    let mut tables = tables;
    if tables.is_empty() {
        tables.push(VariantTable { name: "default".into(), preset: None, settings: toml::Table::new() });
    }
    let names: Vec<&str> = tables.iter().map(|t| t.name.as_str()).collect();
    unique("the list of variants", &names)?;
    tables.into_iter().map(|table| variant(table, limits)).collect()
}

fn variant(table: VariantTable, limits: &Limits) -> std::result::Result<Variant, String> {
    let VariantTable { name, preset, settings: own } = table;
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if name.is_empty() || !name.chars().all(allowed) {
        return Err(format!("variant \"{name}\": a name has letters, digits, - and _ only"));
    }
    for (key, instead) in [("scene", "scenes"), ("seed", "seeds"), ("memory", "limits.memory_budget")] {
        if own.contains_key(key) {
            return Err(format!("variant \"{name}\" sets {key}; use {instead} of the manifest"));
        }
    }
    let resolve = || -> sgs_config::Result<Settings> {
        let mut all = match &preset {
            Some(preset) => Preset::find(preset)?.table()?,
            None => toml::Table::new(),
        };
        overlay(&mut all, own);
        let mut settings = Settings::from_table(all)?;
        if let Some(budget) = limits.memory_budget {
            settings.memory.budget = budget;
        }
        settings.check()?;
        Ok(settings)
    };
    let settings = resolve().map_err(|e| format!("variant \"{name}\": {e}"))?;
    Ok(Variant { name, settings })
}

/// Returns the scenes of paths and patterns.
///
/// Also returns matching folders that hold no scene.
fn scenes(patterns: &[String], folder: &Path) -> std::result::Result<(Vec<PathBuf>, Vec<PathBuf>), String> {
    unique("scenes", patterns)?;
    let (mut found, mut ignored): (Vec<PathBuf>, Vec<PathBuf>) = Default::default();
    for pattern in patterns {
        let path = folder.join(pattern);
        let matches = if pattern.contains('*') {
            let (scenes, others) = matching(&path, pattern)?;
            ignored.extend(others);
            scenes
        } else if Layout::of(&path).is_some() {
            vec![path]
        } else {
            return Err(format!("\"{pattern}\" is no scene; name a scene directory"));
        };
        for path in matches {
            let path = named(&path).map_err(|e| format!("\"{}\" cannot be read: {e}", path.display()))?;
            if !found.contains(&path) {
                found.push(path);
            }
        }
    }
    for (i, path) in found.iter().enumerate() {
        let name =
            name_of(path).ok_or_else(|| format!("\"{}\" has no name in plain text; rename it", path.display()))?;
        if let Some(other) = found[..i].iter().find(|p| name_of(p) == Some(name)) {
            let (a, b) = (other.display(), path.display());
            return Err(format!("\"{a}\" and \"{b}\" have the same name; rename one of them"));
        }
    }
    Ok((found, ignored))
}

/// Returns the absolute path of a scene, which has a name.
///
/// A link keeps its name: machines may keep the data itself in different places.
fn named(path: &Path) -> std::io::Result<PathBuf> {
    let own = std::path::absolute(path).ok().filter(|p| p.file_name().is_some());
    own.map_or_else(|| path.canonicalize(), Ok)
}

/// Returns the last component of a scene's path.
pub(crate) fn name_of(path: &Path) -> Option<&str> {
    path.file_name()?.to_str().filter(|name| !name.chars().any(char::is_control))
}

type Matches = (Vec<PathBuf>, Vec<PathBuf>);

/// Returns the scenes that match a pattern, in order, and other folders.
fn matching(path: &Path, pattern: &str) -> std::result::Result<Matches, String> {
    let parent = path.parent().unwrap_or(Path::new("."));
    let last = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    if !last.contains('*') || parent.to_string_lossy().contains('*') {
        return Err(format!("\"{pattern}\" has * in a folder; use * in the last component only"));
    }
    let entries = std::fs::read_dir(parent).map_err(|e| format!("\"{}\" cannot be read: {e}", parent.display()))?;
    let names = entries.flatten().filter_map(|e| e.file_name().into_string().ok());
    let visible = |name: &String| !name.starts_with('.') || last.starts_with('.');
    let mut names: Vec<String> = names.filter(visible).filter(|name| matches(last, name)).collect();
    names.sort();
    let folders = names.into_iter().map(|name| parent.join(name)).filter(|path| path.is_dir());
    let (scenes, others): Matches = folders.partition(|path| Layout::of(path).is_some());
    if scenes.is_empty() {
        return Err(format!("\"{pattern}\" matches no scene; correct the pattern"));
    }
    Ok((scenes, others))
}

/// Returns whether a name matches a pattern. `*` stands for any characters.
fn matches(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == name,
        Some((start, rest)) => {
            let Some(name) = name.strip_prefix(start) else { return false };
            let ends = name.char_indices().map(|(i, _)| i).chain([name.len()]);
            ends.into_iter().any(|i| matches(rest, &name[i..]))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in ["rooms/b", "rooms/a", "kitchen", "more/a"] {
            let sparse = folder.path().join(name).join("sparse/0");
            std::fs::create_dir_all(&sparse).unwrap();
            std::fs::write(sparse.join("cameras.txt"), "").unwrap();
        }
        std::fs::create_dir(folder.path().join("rooms/notes")).unwrap();
        std::fs::write(folder.path().join("rooms/c"), "a file").unwrap();
        folder
    }

    fn parse(text: &str) -> std::result::Result<Manifest, String> {
        Manifest::parse(text, place().path())
    }

    #[test]
    fn defaults_and_patterns_are_resolved() {
        let m = parse("scenes = [\"rooms/*\", \"kitchen\", \"rooms/a\"]").unwrap();
        let names: Vec<_> = m.scenes.iter().map(|s| name_of(s).unwrap()).collect();
        assert_eq!(names, ["a", "b", "kitchen"]);
        assert_eq!(m.ignored.len(), 1);
        assert_eq!((m.seeds, m.stage, m.evaluate), (vec![0], Stage::Geometry, true));
        assert_eq!(m.limits, Limits { retries: 2, timeout: None, memory_budget: None });
        assert_eq!(m.variants, [Variant { name: "default".into(), settings: Settings::default() }]);
        let text = "scenes = [\"kitchen\"]\nstage = \"all\"\n[[variants]]\nname = \"f\"\npreset = \"draft\"\n\
                    settings = { geometry = { steps = 20 } }\n[limits]\ntimeout = 3\nmemory_budget = \"1G\"";
        let m = parse(text).unwrap();
        let draft = Settings::from_table(Preset::find("draft").unwrap().table().unwrap()).unwrap();
        let settings = &m.variants[0].settings;
        assert_eq!((settings.geometry.steps, settings.memory.budget), (20, 1 << 30));
        assert_eq!(settings.intrinsic, draft.intrinsic);
        assert_eq!(m.limits.timeout, Some(Duration::from_secs(3)));
        assert!(m.stage.steps(settings) > 20);
    }

    #[test]
    fn stars_match_any_characters() {
        for (pattern, name) in [("*", "x"), ("a*", "a"), ("a*c", "abc"), ("*b*", "abc"), ("*é", "aé"), ("a", "a")] {
            assert!(matches(pattern, name), "{pattern} {name}");
        }
        for (pattern, name) in [("a*", "b"), ("a*c", "ab"), ("a", "ab"), ("*aa", "a")] {
            assert!(!matches(pattern, name), "{pattern} {name}");
        }
    }

    #[test]
    fn wrong_manifests_are_refused_in_one_sentence() {
        let kitchen = "scenes = [\"kitchen\"]\n";
        for (text, words) in [
            ("seeds = [0]", "scenes"),
            ("scenes = []", "scenes is empty"),
            ("scenes = [\"nowhere\"]", "\"nowhere\" is no scene"),
            ("scenes = [\"x*\"]", "matches no scene"),
            ("scenes = [\"*/a\"]", "last component only"),
            ("scenes = [\"rooms/a\", \"more/a\"]", "same name"),
            ("scenes = [", "array"),
        ] {
            let refused = parse(text).unwrap_err();
            assert!(refused.contains(words) && !refused.contains('\n'), "{text}: {refused}");
        }
        for (text, words) in [
            ("seed = 1", "unknown field `seed`"),
            ("seeds = []", "seeds is empty"),
            ("seeds = [1, 2, 1]", "seeds has 1 twice"),
            ("seeds = [-1]", "-1"),
            ("stage = \"intrinsic\"", "needs trained geometry"),
            ("stage = \"al\"", "stage is \"al\""),
            ("[limits]\ntimeout = 0", "limits.timeout is 0"),
            ("[limits]\nmemory_budget = \"x\"", "limits.memory_budget"),
            ("[limits]\ntime = 1", "unknown field `time`"),
            ("[[variants]]\nname = \"a/b\"", "variant \"a/b\""),
            ("[[variants]]\nname = \"a\"\n[[variants]]\nname = \"a\"", "a twice"),
            ("[[variants]]\nname = \"a\"\npreset = \"drft\"", "did you mean \"draft\"?"),
            (
                "[[variants]]\nname = \"a\"\nsettings = { geometry = { step = 1 } }",
                "\"geometry.step\" is not a setting",
            ),
            ("[[variants]]\nname = \"a\"\nsettings = { seed = 1 }", "use seeds of the manifest"),
            ("[[variants]]\nname = \"a\"\nsettings = { scale = 2.0 }", "scale is 2"),
            (
                "stage = \"transport\"\n[[variants]]\nname = \"a\"\nsettings = { transport = { surfels = 0 } }",
                "surfels",
            ),
        ] {
            let refused = parse(&format!("{kitchen}{text}")).unwrap_err();
            assert!(refused.contains(words) && !refused.contains('\n'), "{text}: {refused}");
        }
    }
}

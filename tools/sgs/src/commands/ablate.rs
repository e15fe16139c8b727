//! `sgs ablate`: variants of the method trained one after another, and a table of what they came to.

use super::eval::{Split, measure};
use super::train::{Ended, Options, open_scene, settings, train_into, validated};
use crate::cameras::splats_of;
use crate::common::Common;
use crate::ui::interrupted;
use anyhow::bail;
use sgs_scene::Scene;
use sgs_train::ablate::{Ablation, Measures, State, Variant};
use sgs_train::{RunDirectory, Settings};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory, with test views.
    scene: PathBuf,
    /// Directory for a run of each variant and seed, and for ablation.md and ablation.json.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Variants: rgb, normal, semantic, correspondence; each uses what those before it use. By default all that differ on
    /// this scene.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    only: Vec<String>,
    /// How many seeds, from --seed on.
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    #[command(flatten)]
    options: Options,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let base = settings(&a.scene, &a.options)?;
    let wanted = Variant::named(&a.only)?;
    let scene = open_scene(&base)?;
    if scene.split.test.is_empty() {
        bail!("\"{}\" has no test views to compare variants at; name some in split.json.", a.scene.display());
    }
    let wanted = possible(wanted, &scene, &base, a)?;
    let Some(last) = base.seed.checked_add(a.seeds - 1) else {
        bail!("--seeds {} goes beyond the largest seed from --seed {} on.", a.seeds, base.seed);
    };
    let stop = interrupted()?;
    let (scene, steps) = (a.scene.display().to_string(), base.geometry.steps);
    let mut table = Ablation { scene, steps, ..Ablation::default() };
    std::fs::create_dir_all(&a.output)
        .map_err(|e| anyhow::anyhow!("\"{}\" cannot be made: {e}.", a.output.display()))?;
    // Seed by seed, so that an early look compares all variants. One that was measured before stays in the table.
    for seed in base.seed..=last {
        for variant in Variant::all() {
            let mut asked = variant.settings(&base);
            asked.seed = seed;
            let root = a.output.join(variant.folder(seed));
            match come_to(common, variant, asked, &root, wanted.contains(variant), &stop)? {
                Came::To(device, measures) => table.add(variant, seed, device, measures),
                Came::Nowhere => continue,
                Came::Stopped => {
                    eprintln!("stopped in {}; the same command goes on from there", root.display());
                    std::process::exit(1);
                }
            }
            write(&a.output, &table)?;
        }
    }
    if !common.answer(&table)? {
        print!("{}", table.markdown());
    }
    Ok(())
}

/// The variants that differ from the others on this scene. Who asks for another by name is told.
fn possible(variants: Vec<Variant>, scene: &Scene, base: &Settings, a: &Args) -> anyhow::Result<Vec<Variant>> {
    let mut kept = Vec::new();
    for variant in variants {
        match variant.lacks(scene, base)? {
            None => kept.push(variant),
            Some(lacking) if a.only.is_empty() => {
                tracing::warn!("The variant \"{}\" is left out: {lacking}.", variant.name);
            }
            Some(lacking) => {
                bail!("The variant \"{}\" would differ from no other: {lacking}.", variant.name);
            }
        }
    }
    Ok(kept)
}

/// What became of a run.
enum Came {
    /// The device that trained it, and what it came to.
    To(String, Measures),
    /// It was not done before and is not wanted now.
    Nowhere,
    /// Somebody wanted to stop.
    Stopped,
}

/// Trains and measures a run as far as that is wanted and was not done before.
fn come_to(
    common: &Common,
    variant: &Variant,
    mut asked: Settings,
    root: &Path,
    wanted: bool,
    stop: &AtomicBool,
) -> anyhow::Result<Came> {
    if !wanted && !root.is_dir() {
        return Ok(Came::Nowhere);
    }
    // Random points are drawn by the seed.
    let scene = Scene::open(&asked.scene, &asked.scene_options())?;
    asked.exposure = scene.exposure();
    asked.check()?;
    let state = State::of(root, &asked);
    if let State::Measured(measures) = state {
        return Ok(Came::To(trained_on(root), measures));
    }
    if !wanted {
        return Ok(Came::Nowhere);
    }
    if stop.load(Ordering::SeqCst) {
        return Ok(Came::Stopped);
    }
    // A device of its own, so that its memory's peak is that of this run.
    let device = common.open_device()?;
    if state != State::Trained {
        let what = format!("{}, seed {}", variant.name, asked.seed);
        let ended = train_into(common, &device, &scene, &asked, root, state == State::Begun, stop, &what)?;
        if let Ended::Stopped(_) = ended {
            return Ok(Came::Stopped);
        }
    }
    let (splats, _) = splats_of(root)?;
    let run = RunDirectory::open(root)?;
    measure(&device, &scene, &run, &splats, &asked, Split::Test, None, None)?;
    validated(&device)?;
    match Measures::read(&run) {
        Some(measures) => Ok(Came::To(trained_on(root), measures)),
        None => bail!("\"{}\" was measured, but its metrics.json does not say so.", root.display()),
    }
}

/// The device that a run names.
fn trained_on(root: &Path) -> String {
    let text = std::fs::read_to_string(root.join("training.json")).unwrap_or_default();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    value["device"].as_str().unwrap_or("an unknown device").to_owned()
}

/// Writes what is known so far.
fn write(dir: &Path, table: &Ablation) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(table)?;
    for (name, text) in [("ablation.json", json), ("ablation.md", table.markdown())] {
        sgs_scene::atomic_write(&dir.join(name), |f| f.write_all(text.as_bytes()))?;
    }
    Ok(())
}

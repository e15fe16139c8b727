//! Ablation study: `sgs ablate` trains variants of the method and writes a table of their metrics.

use super::series::{self, About, Row, Start};
use super::train::Stage;
use crate::common::Common;
use crate::failure::refuse_usage;
use sgs_config::Settings;
use sgs_run::StageKind;
use sgs_study::{Entry, Scope, Variant};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    series: series::Series,
    /// Variants to train. Geometry: rgb, depth, normal, semantic, correspondence, each adding one term; no_normal,
    /// no_depth, no_semantic, no_correspondence, the full method without one term. Intrinsic: full, gray_start,
    /// no_lights, no_environment, no_visibility, no_cross_view, no_relight, no_own_prior, no_priors. By default all
    /// that differ on this scene.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    only: Vec<String>,
    /// Stage of the variants: geometry; intrinsic or transport (all on one geometry); or all: geometry, and materials of the
    /// published model.
    #[arg(long, value_enum, default_value = "geometry")]
    stage: Stage,
    /// Geometry for --stage intrinsic or transport, as a 3DGS PLY or a glTF file. By default it is trained for each seed.
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if a.start.is_some() && ![Stage::Intrinsic, Stage::Transport].contains(&a.stage) {
        refuse_usage!("--start gives geometry to variants of materials; add --stage intrinsic or transport.");
    }
    if let Some(file) = a.start.as_deref().filter(|file| !file.is_file()) {
        refuse_usage!("There is no file \"{}\" to start with.", file.display());
    }
    let scope = match a.stage {
        Stage::Geometry => Scope::Geometry,
        Stage::Intrinsic => Scope::Materials,
        Stage::Transport => Scope::Transport,
        Stage::All => Scope::Whole,
    };
    let wanted = Variant::named(scope, &a.only)?;
    let series::Base { settings, scene } = series::base(&a.series)?;
    let possible = |variant: &Variant| Ok(variant.lacks(&scene, &settings)?.map(|lacking| (variant.name, lacking)));
    // The last possible geometry variant uses the most inputs. All variants of materials share its geometry.
    let mut fullest = None;
    for variant in scope.variants().into_iter().filter(|v| v.stage().is_none() && !v.leaves_out()) {
        if variant.lacks(&scene, &settings)?.is_none() {
            fullest = Some(variant);
        }
    }
    let wanted = series::possible("variant", wanted, !a.only.is_empty(), possible)?;
    let common_geometry = fullest.as_ref().map_or_else(|| settings.clone(), |v| v.settings(&settings));
    let start = match &a.start {
        Some(file) => Start::File(file.clone()),
        None => {
            let own = Entry { order: 0, name: "geometry", about: String::new(), run: "geometry" };
            let entry = fullest.as_ref().map_or(own, Variant::entry);
            Start::Training { entry, settings: Box::new(common_geometry.clone()) }
        }
    };
    let row = |variant: &Variant| {
        let materials = variant.stage();
        let base: &Settings = if materials.is_some() { &common_geometry } else { &settings };
        Row {
            entry: variant.entry(),
            settings: variant.settings(base),
            wanted: wanted.contains(variant),
            materials: materials.or((a.stage == Stage::All).then_some(StageKind::Intrinsic)),
            align: false,
            start: materials.is_some().then(|| start.clone()),
        }
    };
    let rows: Vec<Row> = scope.variants().iter().map(row).collect();
    let about = About { name: "ablation", command: "ablate", stage: a.stage.name(), start: a.start.as_deref() };
    series::run(common, &a.series, &about, &settings, &rows)
}

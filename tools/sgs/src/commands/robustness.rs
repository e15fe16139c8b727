//! Robustness study: `sgs robustness` trains from noisy inputs and writes a table of metrics.

use super::series::{self, About, Row};
use super::train::Stage;
use crate::common::Common;
use crate::failure::refuse_usage;
use sgs_run::StageKind;
use sgs_study::Case;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    series: series::Series,
    /// Cases to train: clean, positions (initial points), normals, semantics (priors), poses (training cameras),
    /// learned_poses (training corrects the same cameras). By default all that differ on this scene. noise.* sets the
    /// amounts.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    only: Vec<String>,
    /// Stages to train: geometry; all, which also measures materials of the published model; or transport, which measures
    /// materials and relighting with bounced light.
    #[arg(long, value_enum, default_value = "all")]
    stage: Stage,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let wanted = Case::named(&a.only)?;
    if a.stage == Stage::Intrinsic {
        refuse_usage!(
            "--stage is geometry, transport or all here: materials need the geometry that the noise has led to."
        );
    }
    let series::Base { settings, scene } = series::base(&a.series)?;
    let wanted = series::possible("case", wanted, !a.only.is_empty(), |case| {
        Ok(case.lacks(&scene, &settings)?.map(|lacking| (case.name, lacking.to_owned())))
    })?;
    let row = |case: &Case| Row {
        entry: case.entry(&settings),
        settings: case.settings(&settings),
        wanted: wanted.contains(case),
        materials: match a.stage {
            Stage::Geometry => None,
            Stage::Transport => Some(StageKind::Transport),
            Stage::Intrinsic | Stage::All => Some(StageKind::Intrinsic),
        },
        align: case.aligns(),
        start: None,
    };
    let rows: Vec<Row> = Case::all().iter().map(row).collect();
    let about = About { name: "robustness", command: "robustness", stage: a.stage.name(), start: None };
    series::run(common, &a.series, &about, &settings, &rows)
}

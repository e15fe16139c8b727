//! `sgs ablate`: variants of the method trained one after another, and a table of what they came to.

use super::series::{self, Row};
use super::train::Stage;
use crate::common::Common;
use sgs_train::ablate::Variant;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    series: series::Series,
    /// Variants: rgb, normal, semantic, correspondence; each uses what those before it use. By default all that differ on
    /// this scene.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    only: Vec<String>,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let wanted = Variant::named(&a.only)?;
    let series::Base { settings, scene } = series::base(&a.series)?;
    let wanted = series::possible("variant", wanted, !a.only.is_empty(), |variant| {
        Ok(variant.lacks(&scene, &settings)?.map(|lacking| (variant.name, lacking)))
    })?;
    let row = |variant: &Variant| Row {
        entry: variant.entry(),
        settings: variant.settings(&settings),
        wanted: wanted.contains(variant),
    };
    let rows: Vec<Row> = Variant::all().iter().map(row).collect();
    series::run(common, &a.series, "ablation", &settings, &rows, Stage::Geometry)
}

//! Cost and benefit of each choice that trades accuracy for speed: `engine-bench tradeoff`.
//!
//! Choices are measured in rounds of varying order, with `exact` before and after each. Times are ratios to these, so
//! that slow phases of the machine cancel. They carry their standard error. A choice is on the front if no other
//! ranked choice is both faster and more accurate ([`front`]). Choices that compute the same as `exact`
//! ([`choices::Kind::Same`]) are not ranked.

pub mod again;
#[cfg(test)]
mod baseline;
mod choices;
mod error;
mod front;
mod geometry;
mod intrinsic;
mod lit;
mod plot;
mod quality;
mod record;

use super::step::{Args as StepArgs, Stage};
use crate::common::{Common, parse_size};
use plot::Mark;
use std::path::{Path, PathBuf};

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Scene directory, in place of the synthetic room.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["gaussians", "size"])]
    pub scene: Option<PathBuf>,
    /// Include the semantic loss and the choices of its features. The scene must have the priors.
    #[arg(long, requires = "scene")]
    pub semantics: bool,
    /// Stage whose choices are measured.
    #[arg(long, value_enum, default_value = "geometry")]
    pub stage: Stage,
    /// TOML file with settings of the intrinsic stage, as config.toml of a run. Choices differ from these settings.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Training steps before each choice is measured at the test views. Each choice has a training of its own. Without
    /// this option, quality is not measured.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub quality: Option<u32>,
    /// Trained Gaussians of the scene. Without them, the points of the scene or of the room are trained first.
    #[arg(long, value_name = "FILE.ply", requires = "scene")]
    pub geometry: Option<PathBuf>,
    /// Training steps before the first measurement, if --geometry is absent.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub train: u32,
    /// Number of Gaussians of the synthetic room; 20000 on a CPU, 1000000 elsewhere.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=50_000_000))]
    pub gaussians: Option<u32>,
    /// View size of the synthetic room; 320x240 on a CPU, 1920x1080 elsewhere.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Measure only `exact` and choices whose names contain S.
    #[arg(long, value_name = "S")]
    pub filter: Option<String>,
    /// Number of rounds through all choices, with --repeats steps and frames of each.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub rounds: u32,
    /// Write a plot of time against error.
    #[arg(long, value_name = "FILE.svg")]
    pub svg: Option<PathBuf>,
    /// Write the table as Markdown.
    #[arg(long, value_name = "FILE.md")]
    pub table: Option<PathBuf>,
}

impl Args {
    /// Returns whether a choice is measured; `exact` always is.
    fn wants(&self, choice: &str) -> bool {
        choice == "exact" || self.filter.as_ref().is_none_or(|f| choice.contains(f.as_str()))
    }
}

/// Runs the command.
///
/// # Errors
/// If the device fails, a file cannot be read or written, or `exact` disagrees with double precision.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if a.stage == Stage::Intrinsic {
        anyhow::ensure!(!a.semantics, "--semantics is for --stage geometry.");
        return intrinsic::run(common, a);
    }
    anyhow::ensure!(a.config.is_none(), "--config is for --stage intrinsic.");
    anyhow::ensure!(
        a.quality.is_none() || a.scene.is_some(),
        "--quality needs --scene: the synthetic room has no test views."
    );
    geometry::run(common, a)
}

/// Table and plot of the choices of a stage.
pub struct Presentation {
    /// Table in Markdown.
    table: String,
    /// Marks of the plot, its title, and the label of its error axis.
    marks: Vec<Mark>,
    title: String,
    errors: &'static str,
}

impl Presentation {
    fn svg(&self) -> anyhow::Result<String> {
        plot::svg(&self.marks, &self.title, self.errors)
    }

    /// Writes table and plot to the requested files.
    fn write(&self, table: Option<&Path>, svg: Option<&Path>) -> anyhow::Result<()> {
        let write =
            |path: &Path, text: &str| sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()));
        if let Some(path) = table {
            write(path, &self.table)?;
        }
        if let Some(path) = svg {
            write(path, &self.svg()?)?;
        }
        Ok(())
    }

    /// Writes the requested files after a run.
    ///
    /// Prints the table unless standard output receives the report as JSON.
    fn leave(&self, common: &Common, a: &Args) -> anyhow::Result<()> {
        self.write(a.table.as_deref(), a.svg.as_deref())?;
        if common.json.as_deref().is_none_or(|p| p.as_os_str() != "-") {
            println!("{}", self.table);
        }
        Ok(())
    }
}

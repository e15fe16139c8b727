//! Command line of SGS: `sgs`. Every command is a call into the libraries.
//!
//! Exit status 0 means success. A failure prints one sentence on standard error and returns the status of its kind
//! ([`failure::Kind`]).

mod classes;
mod commands;
mod common;
mod failure;
mod images;
mod lit;
mod message;
mod palette;
mod report;
mod ui;
mod video;
mod viewpoints;
mod watch;

use sgs_api::{cameras, output, scenes};

use clap::{CommandFactory, Parser, Subcommand};
use std::ffi::OsString;
use std::path::Path;

/// Turn a dozen photographs of a room into Gaussians to render and relight. Runs on any Vulkan device.
#[derive(Parser)]
#[command(name = "sgs", version, max_term_width = 80)]
struct Cli {
    #[command(flatten)]
    common: common::Common,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Generate an indoor scene with path-traced images, priors and ground truth.
    Synth(commands::synth::Args),
    /// Make a scene from photographs or a video. Cameras come from the program COLMAP.
    Capture(commands::capture::Args),
    /// Run a provider's networks over a scene's images and write the priors.
    Priors(commands::priors::Args),
    /// Write the cameras of the pseudo-views for external rendering and segmentation.
    Pseudo(commands::pseudo::Args),
    /// Print the model, its reasons and its estimated cost, without training.
    Plan(commands::plan::Args),
    /// Train on a scene directory.
    Train(commands::train::Args),
    /// Train many scenes by a manifest. Skips finished runs, resumes interrupted ones, writes a summary.
    Batch(commands::batch::Args),
    /// Evaluate a run at held-out or training views.
    Eval(commands::eval::Args),
    /// Render images or a video of a run or file from any cameras.
    Render(commands::render::Args),
    /// Render a run with edited lights, materials and objects, without training.
    Relight(commands::relight::Args),
    /// View a run or file in a window. Orbit, fly, switch channels, and edit lights by handles.
    View(commands::view::Args),
    /// Train variants of the method and write a table of each component's contribution.
    Ablate(commands::ablate::Args),
    /// Train from noisy points, priors and poses, and write a table of the effects.
    Robustness(commands::robustness::Args),
    /// Write an HTML report of a run. Shows images side by side, tables, curves, lights, profile and settings.
    Report(commands::report::Args),
    /// Export Gaussians and lighting for other programs, or as a page for browsers.
    Export(commands::export::Args),
    /// List the Vulkan devices that can run SGS, and the features that others lack.
    Devices(commands::devices::Args),
    /// Print a shell completion script.
    Completions(commands::shell::Completions),
    /// Write the manual pages.
    Man(commands::shell::Pages),
}

/// Returns the arguments; joins `--json FILE.json` and `--watch PORT` with "=".
///
/// The values of these options are optional. Without the equals sign, clap would read the following scene as the
/// value, or never read a value.
fn arguments() -> Vec<OsString> {
    let mut joined: Vec<OsString> = Vec::new();
    for argument in std::env::args_os() {
        let file = Path::new(&argument).extension().is_some_and(|e| e == "json");
        let port = argument.to_str().is_some_and(|a| a.parse::<u16>().is_ok());
        match joined.last_mut() {
            Some(last) if file && last == "--json" || port && last == "--watch" => {
                last.push("=");
                last.push(argument);
            }
            _ => joined.push(argument),
        }
    }
    joined
}

fn main() {
    ui::heed_closed_pipes();
    let arguments = arguments();
    let cli = match Cli::try_parse_from(&arguments) {
        Ok(cli) => cli,
        Err(error) => std::process::exit(failure::report_arguments(error, &arguments)),
    };
    ui::start_logging(&cli.common);
    ui::heed_supervisor();
    let result = match &cli.command {
        Command::Synth(a) => commands::synth::run(&cli.common, a),
        Command::Capture(a) => commands::capture::run(&cli.common, a),
        Command::Priors(a) => commands::priors::run(&cli.common, a),
        Command::Pseudo(a) => commands::pseudo::run(&cli.common, a),
        Command::Plan(a) => commands::plan::run(&cli.common, a),
        Command::Train(a) => commands::train::run(&cli.common, a),
        Command::Batch(a) => commands::batch::run(&cli.common, a),
        Command::Eval(a) => commands::eval::run(&cli.common, a),
        Command::Render(a) => commands::render::run(&cli.common, a),
        Command::Relight(a) => commands::relight::run(&cli.common, a),
        Command::View(a) => commands::view::run(&cli.common, a),
        Command::Ablate(a) => commands::ablate::run(&cli.common, a),
        Command::Robustness(a) => commands::robustness::run(&cli.common, a),
        Command::Report(a) => commands::report::run(&cli.common, a),
        Command::Export(a) => commands::export::run(&cli.common, a),
        Command::Devices(a) => commands::devices::run(&cli.common, a),
        Command::Completions(a) => commands::shell::completions(a, Cli::command()),
        Command::Man(a) => commands::shell::man(&cli.common, a, Cli::command()),
    };
    if let Err(error) = result {
        std::process::exit(failure::report(&cli.common, &error));
    }
}

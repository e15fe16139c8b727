//! `sgs`: the command line. Thin: every command is a call into the libraries.
//!
//! Exit status 0 done; otherwise one sentence on standard error and the status of its kind ([`failure::Kind`]).

mod cameras;
mod classes;
mod commands;
mod common;
mod failure;
mod output;
mod palette;
mod pictures;
mod report;
mod scenes;
mod ui;
mod video;
mod viewpoints;
mod watch;

use clap::{CommandFactory, Parser, Subcommand};
use std::ffi::OsString;
use std::path::Path;

/// Turn a dozen photographs of a room into Gaussians that can be rendered and relit, on any Vulkan device.
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
    /// Make an indoor scene directory with path-traced images, priors and ground truth.
    Synth(commands::synth::Args),
    /// Run a provider of networks over a scene's images and write its priors.
    Priors(commands::priors::Args),
    /// Write the cameras of the pseudo-views, to be rendered and segmented outside.
    Pseudo(commands::pseudo::Args),
    /// Print what will be modeled, why, and what it costs; train nothing.
    Plan(commands::plan::Args),
    /// Train on a scene directory.
    Train(commands::train::Args),
    /// Measure a run at held-out or training views.
    Eval(commands::eval::Args),
    /// Render a run or a file from the cameras of a transforms file.
    Render(commands::render::Args),
    /// Render a run under other lights, of other materials, with other things in it; train nothing.
    Relight(commands::relight::Args),
    /// Open a window on a run or a PLY: orbit, fly, other channels, lights as handles.
    View(commands::view::Args),
    /// Train variants of the method and write a table of what each part is worth.
    Ablate(commands::ablate::Args),
    /// Train from noisy points, priors and poses, and write a table of what the noise does.
    Robustness(commands::robustness::Args),
    /// Write one page that shows a run: pictures side by side, tables, curves, lights, profile, settings.
    Report(commands::report::Args),
    /// Write Gaussians, materials and light for other programs: PLY, glTF.
    Export(commands::export::Args),
    /// List what can run here, and what each device lacks.
    Devices,
    /// Print what completes this command line in a shell.
    Completions(commands::shell::Completions),
    /// Write the manual pages.
    Man(commands::shell::Pages),
}

/// The arguments, with `--json FILE.json` and `--watch PORT` made one each: what follows is optional, and without the equals
/// sign the option would otherwise swallow the scene that stands behind it, or never take anything.
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
    let result = match &cli.command {
        Command::Synth(a) => commands::synth::run(&cli.common, a),
        Command::Priors(a) => commands::priors::run(&cli.common, a),
        Command::Pseudo(a) => commands::pseudo::run(&cli.common, a),
        Command::Plan(a) => commands::plan::run(&cli.common, a),
        Command::Train(a) => commands::train::run(&cli.common, a),
        Command::Eval(a) => commands::eval::run(&cli.common, a),
        Command::Render(a) => commands::render::run(&cli.common, a),
        Command::Relight(a) => commands::relight::run(&cli.common, a),
        Command::View(a) => commands::view::run(&cli.common, a),
        Command::Ablate(a) => commands::ablate::run(&cli.common, a),
        Command::Robustness(a) => commands::robustness::run(&cli.common, a),
        Command::Report(a) => commands::report::run(&cli.common, a),
        Command::Export(a) => commands::export::run(&cli.common, a),
        Command::Devices => commands::devices::run(&cli.common),
        Command::Completions(a) => commands::shell::completions(a, Cli::command()),
        Command::Man(a) => commands::shell::man(&cli.common, a, Cli::command()),
    };
    if let Err(error) = result {
        std::process::exit(failure::report(&cli.common, &error));
    }
}

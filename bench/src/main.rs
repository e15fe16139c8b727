//! `engine-bench`: time of every pass on a device, against the measured ceiling of that device.
//!
//! Every command states device, driver, sizes, repeats, median and spread, and checks its results: no time is reported for a
//! kernel with a wrong result. `--json` writes a report, `--compare` compares this run with one.
//!
//! Exit status 0 done, 1 failed or worse than the baseline, 2 wrong usage.

mod ceiling;
mod commands;
mod common;
mod harness;
mod micro;
mod process;
mod report;
mod stats;
mod trainer;
mod workload;

use clap::{Parser, Subcommand};

/// Measure kernels and whole training steps on a Vulkan device.
#[derive(Parser)]
#[command(name = "engine-bench", version, about, max_term_width = 100)]
struct Cli {
    #[command(flatten)]
    common: common::Common,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Single stages at stated sizes, each checked against its CPU reference.
    Passes(commands::passes::Args),
    /// A whole training step and a whole render, pass by pass.
    Step(commands::step::Args),
    /// How time and memory grow with Gaussians and pixels.
    Scaling(commands::scaling::Args),
    /// Cost and benefit of every choice that trades accuracy for speed, and the Pareto front.
    Tradeoff(commands::tradeoff::Args),
    /// Table and drawing of an existing report of `tradeoff`.
    Front(commands::tradeoff::again::Args),
    /// Time of each optimization of the intrinsic stage, with and without it.
    Savings(commands::savings::Args),
    /// Peak rates and overheads of the device: copies, arithmetic, dispatches, barriers.
    Ceiling,
    /// Put reports of one device into one file.
    Join(commands::results::Join),
    /// Print files of reports as a table in Markdown.
    Table(commands::results::Table),
}

/// Exits quietly with the status of SIGPIPE if standard output is closed.
fn heed_closed_pipes() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        let text = info.payload().downcast_ref::<String>().map_or("", String::as_str);
        if text.starts_with("failed printing to ") && text.contains("Broken pipe") {
            std::process::exit(128 + 13);
        }
        usual(info);
    }));
}

fn main() {
    heed_closed_pipes();
    let cli = Cli::parse();
    let result = match &cli.command {
        Command::Passes(a) => commands::passes::run(&cli.common, a),
        Command::Step(a) => commands::step::run(&cli.common, a),
        Command::Scaling(a) => commands::scaling::run(&cli.common, a),
        Command::Tradeoff(a) => commands::tradeoff::run(&cli.common, a),
        Command::Front(a) => commands::tradeoff::again::run(a),
        Command::Savings(a) => commands::savings::run(&cli.common, a),
        Command::Ceiling => commands::ceiling::run(&cli.common),
        Command::Join(a) => commands::results::join(a),
        Command::Table(a) => commands::results::print(a),
    };
    if let Err(error) = result {
        eprintln!("engine-bench: {error:#}");
        std::process::exit(1);
    }
}

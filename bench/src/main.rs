//! Benchmarks of every pass on a device, relative to the measured ceiling: `engine-bench`.
//!
//! Every command reports device, driver, sizes, repeats, median and spread, and checks its results. No time is
//! reported for a kernel with a wrong result. `--json` writes a report; `--compare` compares this run with a report.
//!
//! Exit status: 0 for success, 1 for a failure or a result worse than the baseline, 2 for wrong usage.

mod ceiling;
mod commands;
mod common;
mod harness;
mod isa;
mod micro;
mod process;
mod report;
mod simulate;
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
    /// Measure single stages at given sizes, each checked against its CPU reference.
    Passes(commands::passes::Args),
    /// Measure a whole training step and a whole render, pass by pass.
    Step(commands::step::Args),
    /// Measure how time and memory scale with Gaussians and pixels.
    Scaling(commands::scaling::Args),
    /// Measure every choice that trades accuracy for speed. Reports cost, benefit and the Pareto front.
    Tradeoff(commands::tradeoff::Args),
    /// Write the table and plot of an existing report of `tradeoff`.
    Front(commands::tradeoff::again::Args),
    /// Measure the intrinsic stage with and without each of its optimizations.
    Savings(commands::savings::Args),
    /// Simulate the queue of `sgs batch` for many rooms and devices.
    Batch(Box<commands::batch::Args>),
    /// Train several rooms at a time on one device: as processes and in one process.
    Rooms(commands::rooms::Args),
    /// Measure the host's time of a step with a driver that runs no kernels.
    Host(commands::host::Args),
    /// Predict the step of a report on other devices, pass by pass.
    Roofline(commands::roofline::Args),
    /// Measure peak rates of the device, and overheads of dispatches and barriers.
    Ceiling,
    /// Compile every kernel for absent GPUs. Reports registers, spills and shared memory.
    Isa(commands::isa::Args),
    /// Compile kernels that standard input names.
    #[command(hide = true)]
    IsaWorker,
    /// Join reports of one device into one file.
    Join(commands::results::Join),
    /// Print report files as a Markdown table.
    Table(commands::results::Table),
}

/// Installs a panic hook that ends the program silently if its output is closed.
///
/// The exit status is that of a program ended by SIGPIPE.
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
        Command::Batch(a) => commands::batch::run(&cli.common, a),
        Command::Rooms(a) => commands::rooms::run(&cli.common, a),
        Command::Host(a) => commands::host::run(&cli.common, a),
        Command::Roofline(a) => commands::roofline::run(a),
        Command::Ceiling => commands::ceiling::run(&cli.common),
        Command::Isa(a) => commands::isa::run(&cli.common, a),
        Command::IsaWorker => isa::worker::run(),
        Command::Join(a) => commands::results::join(a),
        Command::Table(a) => commands::results::print(a),
    };
    if let Err(error) = result {
        eprintln!("engine-bench: {error:#}");
        std::process::exit(1);
    }
}

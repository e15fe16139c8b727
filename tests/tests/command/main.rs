//! Commands, files and reports: refusals, formats, measures.

mod capture;
mod captured;
mod classes;
mod cli;
mod emitters;
mod exchange;
mod foreign_programs;
mod formats;
mod layouts;
mod lpips;
mod memory_of_training;
mod metrics;
mod outputs;
mod page;
mod photogrammetry;
mod presets;
mod priors;
mod providers;
mod relight;
mod render;
mod report;
mod shell;
mod splits;
mod statuses;
mod viewpoints;

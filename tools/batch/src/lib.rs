//! Batches: many scenes trained by one command, on one or several machines.
//!
//! A manifest is expanded to runs ([`Batch`]). Several workers share the runs through a directory ([`Store`]): leases
//! say who trains a run, results say how it ended. [`Queue`] supervises the processes that train.

mod admission;
mod baseline;
mod batch;
mod error;
mod forecast;
mod heart;
mod holder;
mod identity;
mod lease;
mod list;
mod manifest;
mod process;
mod queue;
mod records;
mod result;
mod selection;
mod slurm;
mod store;
mod summary;
mod timing;

pub use admission::DeviceMemory;
pub use baseline::{Baseline, Verdict};
pub use batch::{Batch, Run, Shard, most_expensive_first};
pub use error::{BatchError, Result};
pub use forecast::Forecast;
pub use identity::{Digest, scene_digest};
pub use lease::Lease;
pub use list::{Listed, list};
pub use manifest::{Limits, Manifest, Stage, Variant};
pub use process::{Exit, Launch, Launcher, Phase, Process};
pub use queue::{Planner, Progress, Queue, Report};
pub use result::{RunResult, State};
pub use slurm::{ArrayScript, quote};
pub use store::{Claim, Store};
pub use summary::Summary;
pub use timing::Timing;

//! Operations on scenes and runs, for the command line and the Python package.
//!
//! Training with its checks, evaluation, relighting, and the kinds of their failures. Errors are sentences; their kind
//! determines the exit status ([`Kind`]). Sentences name the options of the command line.

pub mod cameras;
mod channels;
mod classes;
mod device;
mod evaluation;
mod failure;
pub mod output;
mod relighting;
pub mod scenes;
mod settings;
mod training;

pub use channels::{Part, check_materials, light_of_source};
pub use classes::head_of;
pub use device::cache_folder;
pub use evaluation::{EvaluatedImages, MeasureOptions, Split, measure};
pub use failure::{Failure, Kind, failure, usage};
pub use relighting::{Relighting, RelitScene, Shadows};
pub use settings::{Overrides, settings};
pub use training::{LockedTrainer, Stages, TrainRequest, Training, prepare_training};

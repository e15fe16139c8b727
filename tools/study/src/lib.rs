//! Comparison of trainings: ablations, robustness and tables of results.
//!
//! A [`Variant`] leaves out a component of the method, a [`Case`] adds noise to its inputs, and [`Ablation`] is the
//! table over several seeds.
//!
//! Guarantees: a finished run with the same settings is recognized, and so is a run that can be resumed. The caller
//! trains and evaluates.

mod case;
mod change;
mod error;
mod state;
mod table;
mod variant;

pub use case::Case;
pub use error::{Result, StudyError};
pub use state::{Goal, Measures, State};
pub use table::{Ablation, AblationRow, AblationRun, Entry};
pub use variant::{Scope, Variant};

//! Trainings compared: what each part of the method is worth ([`Variant`]), what noise in its inputs does ([`Case`]), and a table of
//! what they came to over several seeds.
//!
//! Promises: a run that is done with the same settings is recognized, and so is one that can be gone on with. Training and
//! measuring themselves are the caller's.

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

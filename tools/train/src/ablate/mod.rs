//! What each part of the method is worth: variants of the settings, and a table of what they came to over several seeds.
//!
//! Promises: a run that is done with the same settings is recognized, and so is one that can be gone on with. Training and
//! measuring themselves are the caller's.

mod state;
mod table;
mod variant;

pub use state::{Measures, State};
pub use table::{Ablation, AblationRow, AblationRun};
pub use variant::Variant;

//! Graph tests without a device: every compile step alone, every error, a golden plan, random graphs, and damaged
//! plans that the verifier must reject.

mod builder_errors;
mod condition;
mod history;
mod images;
mod kernels;
mod mutate;
mod page;
mod phases;
mod queue;
mod random;
mod scale;
mod snapshot;
mod verify_errors;

use super::*;

//! Graph tests without a device: every compile step alone, every error, a golden plan, random graphs, and damaged
//! plans that the verifier must reject.

mod builder_errors;
mod images;
mod kernels;
mod mutate;
mod page;
mod phases;
mod random;
mod scale;
mod snapshot;
mod verify_errors;

use super::*;

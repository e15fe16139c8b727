//! Relightings.

use sgs_relight::Relighter;
use std::sync::{Arc, Mutex, MutexGuard};

/// Relighting that its views share.
#[derive(Clone)]
pub struct RelightObject(Arc<Mutex<Relighter>>);

impl RelightObject {
    pub fn new(relight: Relighter) -> RelightObject {
        RelightObject(Arc::new(Mutex::new(relight)))
    }

    /// Locks the relighting. Never waits: calls of a context are serialized.
    pub fn hold(&self) -> MutexGuard<'_, Relighter> {
        self.0.lock().unwrap_or_else(|e| e.into_inner())
    }
}

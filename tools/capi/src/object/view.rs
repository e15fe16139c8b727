//! Views.

use crate::border::Outcome;
use crate::object::{RelightObject, SceneObject};
use sgs_engine::DeviceImage;
use sgs_passes::pipeline::{LitView, View};
use sgs_passes::splat::TexelFormat;
use std::collections::HashMap;
use std::sync::Arc;

/// View, its content, and the host's images that it has wrapped.
pub struct ViewObject {
    pub shows: Shows,
    pub images: HashMap<u64, DeviceImage>,
}

/// Content of a view.
#[allow(clippy::large_enum_variant, reason = "views are boxed, and there are few")]
pub enum Shows {
    Scene(Arc<SceneObject>, View),
    /// Relighting with its view and exposure, a factor.
    Relight(RelightObject, LitView, f32),
}

impl ViewObject {
    pub fn new(shows: Shows) -> ViewObject {
        ViewObject { shows, images: HashMap::new() }
    }

    /// Returns the number of recordings that are not done.
    pub fn open(&self) -> Outcome<usize> {
        Ok(match &self.shows {
            Shows::Scene(_, view) => view.recordings()?,
            Shows::Relight(_, view, _) => view.recordings()?,
        })
    }

    /// Returns the size and the format of the images.
    pub fn target(&self) -> ([u32; 2], TexelFormat) {
        match &self.shows {
            Shows::Scene(_, view) => (view.options().size, view.options().presented.format),
            Shows::Relight(_, view, _) => (view.options().size, view.options().format),
        }
    }
}

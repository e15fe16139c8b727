//! Objects that the handles of a context stand for. They do not know contexts.

mod relight;
mod scene;
mod trainer;
mod view;

pub use relight::RelightObject;
pub use scene::SceneObject;
pub use trainer::TrainerObject;
pub use view::{Shows, ViewObject};

use crate::table::Object;
use sgs_engine::exec::Recording;
use std::sync::Arc;

/// Object of a context.
pub enum Thing {
    Scene(Arc<SceneObject>),
    Cameras(Vec<sgs_scene::Camera>),
    View(Box<ViewObject>),
    Recording(Recording),
    Trainer(Box<TrainerObject>),
    Relight(RelightObject),
}

impl Object for Thing {
    const KINDS: &'static [&'static str] = &["scene", "list of cameras", "view", "recording", "trainer", "relighting"];

    fn kind(&self) -> u64 {
        match self {
            Thing::Scene(_) => 1,
            Thing::Cameras(_) => 2,
            Thing::View(_) => 3,
            Thing::Recording(_) => 4,
            Thing::Trainer(_) => 5,
            Thing::Relight(_) => 6,
        }
    }
}

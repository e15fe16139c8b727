//! Output of plans: text for reading and snapshots, JSON for tools, DOT for diagrams, and an HTML page.
//!
//! All are pure functions of the plan, plus optional measured times. Equal plans give equal output. A trace
//! contains only measured times.

mod causes;
mod dot;
mod html;
mod json;
mod text;
mod trace;

pub use dot::dot;
pub use html::html;
pub use json::json;
pub use text::text;
pub use trace::{Track, trace};

use super::pass::{Dispatch, Pass, PassKind, Use};
use super::plan::{ImageMemory, Plan, Transition};
use super::resource::ImageState;
use crate::shader::Access;

/// Measured times of one pass.
#[derive(Clone, Debug)]
pub struct PassTime {
    /// Name of the pass.
    pub name: String,
    /// By replay: start in nanoseconds, relative to the first pass of the replay.
    pub start: Vec<f64>,
    /// By replay: duration in nanoseconds.
    pub nanoseconds: Vec<f64>,
}

/// Returns the names of a pass's accesses, in order.
fn labels(pass: &Pass) -> Vec<&str> {
    match &pass.kind {
        PassKind::Fill { .. } => vec!["target"],
        PassKind::Copy { .. } | PassKind::CopyToImage { .. } | PassKind::CopyFromImage { .. } => {
            vec!["source", "target"]
        }
        PassKind::ClearImage { .. } => vec!["target"],
        PassKind::Compute { shader, .. } => {
            shader.bindings.iter().map(|binding| binding.name.as_ref()).chain(["group counts"]).collect()
        }
    }
}

/// Returns a short description of a pass.
fn describe(pass: &Pass) -> String {
    match &pass.kind {
        PassKind::Fill { value, .. } => format!("fill {value:#x}"),
        PassKind::Copy { .. } => "copy".to_owned(),
        PassKind::CopyToImage { .. } => "copy to image".to_owned(),
        PassKind::CopyFromImage { .. } => "copy from image".to_owned(),
        PassKind::ClearImage { value: [r, g, b, a], .. } => format!("clear {r:#x} {g:#x} {b:#x} {a:#x}"),
        PassKind::Compute { shader, dispatch, .. } => match dispatch {
            Dispatch::Groups([x, y, z]) => format!("{} {x}x{y}x{z}", shader.name),
            Dispatch::Indirect { .. } => format!("{} indirect", shader.name),
        },
    }
}

/// Formats a layout transition on one line.
fn transition(plan: &Plan, change: &Transition) -> String {
    let image = match change.image {
        ImageMemory::External(image) => plan.buffers[image.index()].name.clone(),
        ImageMemory::Slot(slot) => format!("slot {slot}"),
    };
    format!("layout of {image}: {} -> {}", state(change.from), state(change.to))
}

/// Returns the name of an image state.
fn state(state: ImageState) -> &'static str {
    match state {
        ImageState::Undefined => "undefined",
        ImageState::General => "general",
        ImageState::TransferSource => "transfer source",
        ImageState::TransferTarget => "transfer target",
        ImageState::ShaderRead => "shader read",
        ImageState::ColorAttachment => "color attachment",
        ImageState::Present => "present",
    }
}

/// Returns the name of an access.
fn verb(access: Access, used: Use) -> &'static str {
    match (used, access) {
        (Use::Indirect, _) => "indirect",
        (Use::Uniform, _) => "uniform",
        (_, Access::Read) => "read",
        (_, Access::Write) => "write",
        (_, Access::ReadWrite) => "read+write",
        (_, Access::Accumulate) => "accumulate",
    }
}

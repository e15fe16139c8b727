//! Plans for people and programs: text for reading and for snapshots, JSON for tools, DOT for pictures, and a page of
//! HTML for looking at everything.
//!
//! All are functions of the plan alone and equal for equal plans, unless measured times are given too. A trace shows
//! nothing but measured times.

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

/// What a pass calls each of its accesses, in their order.
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

/// What a pass does, in a few words.
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

/// A change of an image's layout, in a line.
fn transition(plan: &Plan, change: &Transition) -> String {
    let image = match change.image {
        ImageMemory::External(image) => plan.buffers[image.index()].name.clone(),
        ImageMemory::Slot(slot) => format!("slot {slot}"),
    };
    format!("layout of {image}: {} -> {}", state(change.from), state(change.to))
}

/// What a state is called.
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

/// How a range is touched, in a word or two.
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

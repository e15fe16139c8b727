//! Plans for people and programs: text for reading and for snapshots, JSON for tools, DOT for pictures.
//!
//! These three are functions of the plan alone and equal for equal plans. A trace shows measured times.

mod dot;
mod json;
mod text;
mod trace;

pub use dot::dot;
pub use json::json;
pub use text::text;
pub use trace::{Track, trace};

use super::pass::{Dispatch, Pass, PassKind, Use};
use crate::shader::Access;

/// What a pass calls each of its accesses, in their order.
fn labels(pass: &Pass) -> Vec<&str> {
    match &pass.kind {
        PassKind::Fill { .. } => vec!["target"],
        PassKind::Copy { .. } => vec!["source", "target"],
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
        PassKind::Compute { shader, dispatch, .. } => match dispatch {
            Dispatch::Groups([x, y, z]) => format!("{} {x}x{y}x{z}", shader.name),
            Dispatch::Indirect { .. } => format!("{} indirect", shader.name),
        },
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

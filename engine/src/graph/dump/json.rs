//! JSON output of a plan, for tools.

use serde::Serialize;

use super::{describe, labels};
use crate::format::ImageFormat;
use crate::graph::pass::{Pass, Use};
use crate::graph::plan::{Barrier, ImageSlot, Plan, Transition};
use crate::graph::resource::{Buffer, BufferKind, BufferState, ImageState};
use crate::shader::Access;

/// Returns the plan as indented JSON.
pub fn json(plan: &Plan) -> String {
    serde_json::to_string_pretty(&plan_view(plan)).expect("invariant: names and numbers can be written as JSON")
}

#[derive(Serialize)]
struct PlanView<'p> {
    name: &'p str,
    /// Hexadecimal, because JSON readers round large integers.
    key: String,
    arena_bytes: u64,
    arena_unaliased_bytes: u64,
    buffers: Vec<BufferView<'p>>,
    passes: Vec<PassView<'p>>,
    groups: Vec<GroupView<'p>>,
    final_barrier: Option<Barrier>,
    image_slots: &'p [ImageSlot],
    entry: &'p [Transition],
    exit: &'p [Transition],
    culled: &'p [usize],
}

#[derive(Serialize)]
struct BufferView<'p> {
    name: &'p str,
    bytes: u64,
    kind: BufferKind,
    keep: bool,
    offset: Option<u64>,
    /// First and last group. The offset of an image is its slot index.
    lifetime: Option<(usize, usize)>,
    entry: BufferState,
    exit: BufferState,
    image: Option<ImageView>,
}

#[derive(Serialize)]
struct ImageView {
    size: [u32; 2],
    format: ImageFormat,
    entry: ImageState,
    exit: ImageState,
    home: Option<ImageState>,
}

#[derive(Serialize)]
struct PassView<'p> {
    name: &'p str,
    does: String,
    accesses: Vec<AccessView<'p>>,
    follows: Vec<u32>,
}

#[derive(Serialize)]
struct AccessView<'p> {
    name: &'p str,
    buffer: Buffer,
    offset: u64,
    bytes: u64,
    access: Access,
    #[serde(rename = "use")]
    used: Use,
    discards: bool,
}

#[derive(Serialize)]
struct GroupView<'p> {
    barrier: Option<Barrier>,
    passes: &'p [usize],
}

fn plan_view(plan: &Plan) -> PlanView<'_> {
    let lifetimes = plan.lifetimes();
    PlanView {
        name: &plan.name,
        key: format!("{:016x}", plan.key),
        arena_bytes: plan.arena_bytes,
        arena_unaliased_bytes: plan.arena_unaliased_bytes,
        buffers: plan
            .buffers()
            .map(|(buffer, info)| BufferView {
                name: &info.name,
                bytes: info.bytes,
                kind: info.kind,
                keep: info.keep,
                offset: plan.placements[buffer.index()],
                lifetime: lifetimes[buffer.index()],
                entry: info.entry,
                exit: info.exit,
                image: info.image.map(|image| ImageView {
                    size: image.size,
                    format: image.format,
                    entry: image.entry,
                    exit: image.exit,
                    home: plan.homes[buffer.index()],
                }),
            })
            .collect(),
        passes: plan.passes.iter().zip(plan.dependencies()).map(|(pass, follows)| pass_view(pass, follows)).collect(),
        groups: plan.groups.iter().map(|g| GroupView { barrier: g.barrier, passes: &g.passes }).collect(),
        final_barrier: plan.final_barrier,
        image_slots: &plan.image_slots,
        entry: &plan.entry,
        exit: &plan.exit,
        culled: &plan.culled,
    }
}

fn pass_view(pass: &Pass, follows: Vec<u32>) -> PassView<'_> {
    let accesses = pass.accesses.iter().zip(labels(pass)).map(|((slice, access, used), name)| AccessView {
        name,
        buffer: slice.buffer,
        offset: slice.offset,
        bytes: slice.bytes,
        access: *access,
        used: *used,
        discards: pass.discards(slice),
    });
    PassView { name: &pass.name, does: describe(pass), accesses: accesses.collect(), follows }
}

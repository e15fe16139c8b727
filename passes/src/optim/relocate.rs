//! `relocate`: densification by Markov chain Monte Carlo, on the GPU and in place.
//!
//! Kheradmand et al. 2024, section 3.3. Gaussians whose opacity is below a threshold, or that contain a non-finite number, are dead.
//! Each dead one moves onto a living one, which is drawn in proportion to its opacity. New Gaussians, a twentieth of the number, are
//! drawn in the same way. Opacity and scales of the drawn one and of its copies are corrected (equation 9), so that all of
//! them together look like the one before. The equation's binomial sum is evaluated as the integral that it equals.
//!
//! Guarantees:
//! * The live Gaussians are `0..N'` afterwards, and `N'` is at least the number before. It exceeds neither the cap nor the
//!   capacity, unless there were more before.
//! * If all are dead, nothing changes.
//! * Gaussians that are neither dead nor drawn keep their parameters and moments bit for bit. The moments of the others are zero.
//! * The result depends only on the input and the seed.
//!
//! Passes: `relocate_weigh` writes weights and flags, whose prefix sums follow. `relocate_plan` computes totals, `densify_slots` lists the
//! dead, `relocate_draw` draws and lists the copies. `relocate_correct` corrects the drawn ones, and `densify_move` copies columns.
//!
//! Cost per Gaussian: 64 bytes of parameters read, 60 bytes of flags, sums and lists read and written. A drawn one adds
//! 64 bytes, a copy 48 bytes read and 48 written per column. Memory: 36 bytes per Gaussian of the capacity, during the passes.

use super::densify::{Copies, copy_columns};
use crate::Tuning;
use crate::kernel::stage;
use crate::prim::{Count, Records, exclusive_scan};
use crate::scene::{Handles, MomentHandles};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::{Move, RelocatePlan, Work};
use sgs_shaders::{densify_slots, relocate_correct, relocate_draw, relocate_plan, relocate_weigh};

/// Inputs of relocation.
#[derive(Clone, Copy, Debug)]
pub struct Relocate {
    /// Parameters, number and capacity.
    pub gaussians: Handles,
    /// Their moments.
    pub moments: MomentHandles,
    /// Uniform `Densify`. Least opacity, cap and seed are used.
    pub settings: Buffer,
    /// Results, a `DensifyStats`. Dead Gaussians count as pruned, and all copies as cloned.
    pub stats: Buffer,
}

impl Relocate {
    /// Returns the inputs for Gaussians declared for training. Without moments returns `None`.
    pub fn of(gaussians: &Handles, settings: Buffer, stats: Buffer) -> Option<Relocate> {
        Some(Relocate { gaussians: *gaussians, moments: gaussians.moments?, settings, stats })
    }
}

/// Adds all passes of relocation and growth.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn relocate(g: &mut Graph, tuning: Tuning, a: &Relocate) -> Result<(), GraphError> {
    let Tuning { workgroup, .. } = tuning;
    let capacity = a.gaussians.capacity;
    let mut words = |name: &str, words: u64| g.transient(format!("relocate.{name}"), 4 * words);
    let (n, work) = (u64::from(capacity), size_of::<Work>() as u64 / 4);
    let (verdicts, ranks, sums) = (words("verdicts", n), words("ranks", n), words("weights", n));
    let (copies, holes, counters) = (words("copies", n), words("holes", n), words("counters", 1));
    let (before, moves) = (words("before", work), words("moves", work));
    let plan = words("plan", size_of::<RelocatePlan>() as u64 / 4);
    let entries = words("entries", n * size_of::<Move>() as u64 / 4);
    let (dead, total) = (words("dead", 1), words("total", 1));
    let (columns, moment_columns, compact) =
        (a.gaussians.columns(), a.gaussians.model.columns(), a.gaussians.compact());

    g.fill("relocate_clear", counters, 0)?;
    let bindings = relocate_weigh::Bindings {
        params: a.settings.into(),
        live: a.gaussians.work.into(),
        parameters: a.gaussians.parameters.into(),
        verdicts: verdicts.into(),
        is_hole: ranks.into(),
        weights: sums.into(),
        copies: copies.into(),
        counters: counters.into(),
    };
    let specs = relocate_weigh::Specs { workgroup, columns, moment_columns, compact };
    stage(g, "relocate_weigh", &relocate_weigh::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(a.gaussians.work, 0)?;
    let count = Count::Gpu(Records::one(a.gaussians.work, workgroup, capacity));
    exclusive_scan(g, tuning, "relocate_dead", ranks, None, ranks, dead, count)?;
    exclusive_scan(g, tuning, "relocate_sums", sums, None, sums, total, count)?;

    let bindings = relocate_plan::Bindings {
        params: a.settings.into(),
        dead: dead.into(),
        total: total.into(),
        counters: counters.into(),
        live: a.gaussians.work.into(),
        before: before.into(),
        moves: moves.into(),
        plan: plan.into(),
        stats: a.stats.into(),
    };
    let specs = relocate_plan::Specs { per_group: workgroup };
    let push = relocate_plan::Push { capacity };
    let (kernel, push) = (&relocate_plan::KERNEL, bytemuck::bytes_of(&push));
    stage(g, "relocate_plan", kernel, bindings.entries(), specs.entries(), push).dispatch([1, 1, 1])?;

    let bindings = densify_slots::Bindings {
        before: before.into(),
        verdicts: verdicts.into(),
        hole_ranks: ranks.into(),
        holes: holes.into(),
    };
    let specs = densify_slots::Specs { workgroup };
    stage(g, "relocate_slots", &densify_slots::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(before, 0)?;

    let bindings = relocate_draw::Bindings {
        params: a.settings.into(),
        plan: plan.into(),
        sums: sums.into(),
        holes: holes.into(),
        entries: entries.into(),
        copies: copies.into(),
    };
    let specs = relocate_draw::Specs { workgroup };
    stage(g, "relocate_draw", &relocate_draw::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(moves, 0)?;

    let bindings = relocate_correct::Bindings {
        params: a.settings.into(),
        before: before.into(),
        copies: copies.into(),
        parameters: a.gaussians.parameters.into(),
        first_moments: a.moments.first.into(),
        second_moments: a.moments.second.into(),
    };
    let specs = relocate_correct::Specs { workgroup, columns, moment_columns, compact };
    stage(g, "relocate_correct", &relocate_correct::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(before, 0)?;
    copy_columns(g, tuning, &a.gaussians, &a.moments, Copies { moves, entries })
}

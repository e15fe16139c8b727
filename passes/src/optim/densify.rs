//! `densify`: pruning, cloning and splitting of Gaussians, on the GPU and in place.
//!
//! Kerbl et al. 2023, section 5.2, with the pruning by accumulated weight of SGS-Intrinsic. A Gaussian is pruned if its
//! opacity or its accumulated blending weight is below a threshold. Gaussians that are too large or contain a
//! non-finite number are pruned too. Of the others, those with a large mean screen-space gradient are refined. Small
//! ones are cloned: parent and child are equal. Large ones are split: both halves are sampled from the parent, and
//! scales are divided by 1.6. A large mean gradient by the raw normal also causes refinement, if `normal_threshold` is
//! above 0.
//!
//! Guarantees:
//! * The live Gaussians are `0..N'` afterwards. At least one remains if there was one.
//! * `N'` exceeds neither the cap nor the capacity, unless pruning alone leaves more than the cap. If not all
//!   candidates fit, those with the strongest gradients are refined (in steps of an eighth of an octave, then by
//!   index). The number of rejected candidates is reported.
//! * Gaussians that are neither pruned nor split keep their parameters and moments bit for bit. Moments of new
//!   Gaussians are zero.
//! * The result depends only on the input and the seed.
//! * Parameters are not copied as a whole. Nothing is read back: the new count goes into the `Work` record.
//!
//! Passes: `densify_decide` writes verdicts and a histogram of gradient strengths. `densify_plan` computes totals and,
//! if the cap applies, the cut-off. `densify_flags` and prefix sums of three flags rank the pruned Gaussians, the
//! strong ones and those at the cut-off. `densify_slots` lists the holes, `densify_assign` the copies and their
//! targets. `densify_move` copies columns, `densify_move_features` features, `densify_split` makes the halves of
//! splits. Finally the statistics are cleared.
//!
//! Cost per Gaussian: 80 bytes of parameters and statistics read; 100 bytes of flags, ranks and lists read and written.
//! Cloned, split and moved Gaussians add 48 bytes read and 48 to 96 written per column (15 columns with all bands of
//! spherical harmonics). Memory: 36 bytes per Gaussian of the capacity, during the passes.

use crate::Tuning;
use crate::kernel::{splat_specs, stage};
use crate::prim::{Count, Records, ScanShape, exclusive_scan};
use crate::scene::{Group, Handles, MomentHandles};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::{DensifyPlan, Move, Work};
use sgs_shaders::{
    densify_assign, densify_decide, densify_flags, densify_move, densify_move_features, densify_plan, densify_slots,
    densify_split,
};

/// Words of the counters: five, and the histogram of gradient strengths.
const COUNTERS: u64 = 5 + 2048;

/// Inputs of densification.
#[derive(Clone, Copy, Debug)]
pub struct Densify {
    /// Parameters, number and capacity.
    pub gaussians: Handles,
    /// Their moments.
    pub moments: MomentHandles,
    /// By Gaussian: sum of screen gradients, their number, sum of blending weights, sum of gradients by the raw normal.
    pub statistics: Buffer,
    /// Uniform `Densify`: thresholds, cap, seed.
    pub settings: Buffer,
    /// Results, a `DensifyStats`.
    pub stats: Buffer,
}

impl Densify {
    /// Returns the inputs for Gaussians declared for training. Without moments or statistics returns `None`.
    pub fn of(gaussians: &Handles, settings: Buffer, stats: Buffer) -> Option<Densify> {
        Some(Densify {
            gaussians: *gaussians,
            moments: gaussians.moments?,
            statistics: gaussians.statistics?,
            settings,
            stats,
        })
    }

    /// Returns columns of parameters and of moments, and whether storage is compact.
    fn columns(&self) -> (u32, u32, bool) {
        (self.gaussians.columns(), self.gaussians.model.columns(), self.gaussians.compact())
    }
}

/// Buffers that passes write for later passes.
struct Lists {
    verdicts: Buffer,
    counters: Buffer,
    /// Two `Work` records of the count before densification: for these kernels and for the prefix sums.
    before: Buffer,
    plan: Buffer,
    /// Flags, later ranks.
    holes: Buffer,
    strong: Buffer,
    ties: Buffer,
    hole_slots: Buffer,
    moves: Buffer,
    entries: Buffer,
}

impl Lists {
    fn new(g: &mut Graph, capacity: u32) -> Lists {
        let mut words = |name: &str, words: u64| g.transient(format!("densify.{name}"), 4 * words);
        let (n, work) = (u64::from(capacity), size_of::<Work>() as u64 / 4);
        Lists {
            verdicts: words("verdicts", n),
            counters: words("counters", COUNTERS),
            before: words("before", 2 * work),
            plan: words("plan", size_of::<DensifyPlan>() as u64 / 4),
            holes: words("hole_ranks", n),
            strong: words("strong_ranks", n),
            ties: words("tie_ranks", n),
            hole_slots: words("holes", n),
            moves: words("moves", work),
            entries: words("entries", n * size_of::<Move>() as u64 / 4),
        }
    }
}

/// Adds all passes of densification.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn densify(g: &mut Graph, tuning: Tuning, a: &Densify) -> Result<(), GraphError> {
    let lists = Lists::new(g, a.gaussians.capacity);
    decide(g, tuning, a, &lists)?;
    rank(g, tuning, a, &lists)?;
    assign(g, tuning, a, &lists)?;
    copy(g, tuning, a, &lists)?;
    g.fill("densify_reset", a.statistics, 0)
}

/// Adds the passes that compute verdicts and plan.
fn decide(g: &mut Graph, tuning: Tuning, a: &Densify, lists: &Lists) -> Result<(), GraphError> {
    let Tuning { workgroup, .. } = tuning;
    g.fill("densify_clear", lists.counters, 0)?;
    let bindings = densify_decide::Bindings {
        params: a.settings.into(),
        live: a.gaussians.work.into(),
        parameters: a.gaussians.parameters.into(),
        statistics: a.statistics.into(),
        verdicts: lists.verdicts.into(),
        counters: lists.counters.into(),
    };
    let (columns, moment_columns, compact) = a.columns();
    let specs = densify_decide::Specs { workgroup, columns, moment_columns, compact };
    stage(g, "densify_decide", &densify_decide::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(a.gaussians.work, 0)?;

    let bindings = densify_plan::Bindings {
        params: a.settings.into(),
        counters: lists.counters.into(),
        live: a.gaussians.work.into(),
        verdicts: lists.verdicts.into(),
        before: lists.before.into(),
        moves: lists.moves.into(),
        plan: lists.plan.into(),
        stats: a.stats.into(),
    };
    let scan_block = ScanShape::from(tuning).block();
    let specs = densify_plan::Specs { workgroup, per_group: workgroup, scan_block };
    let push = densify_plan::Push { capacity: a.gaussians.capacity };
    let (kernel, push) = (&densify_plan::KERNEL, bytemuck::bytes_of(&push));
    stage(g, "densify_plan", kernel, bindings.entries(), specs.entries(), push).dispatch([1, 1, 1])
}

/// Adds the passes that rank pruned Gaussians, strong candidates and ties.
fn rank(g: &mut Graph, tuning: Tuning, a: &Densify, lists: &Lists) -> Result<(), GraphError> {
    let bindings = densify_flags::Bindings {
        before: lists.before.into(),
        plan: lists.plan.into(),
        verdicts: lists.verdicts.into(),
        is_hole: lists.holes.into(),
        is_strong: lists.strong.into(),
        is_tie: lists.ties.into(),
    };
    let specs = densify_flags::Specs { workgroup: tuning.workgroup };
    stage(g, "densify_flags", &densify_flags::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(lists.before, 0)?;
    let group_sizes = [tuning.workgroup, ScanShape::from(tuning).block(), 0, 0];
    let count = Count::Gpu(Records { slice: lists.before.into(), group_sizes, max: a.gaussians.capacity });
    for (name, flags) in
        [("densify_holes", lists.holes), ("densify_strong", lists.strong), ("densify_ties", lists.ties)]
    {
        let total = g.transient(format!("{name}.total"), 4);
        exclusive_scan(g, tuning, name, flags, None, flags, total, count)?;
    }
    Ok(())
}

/// Adds the passes that assign targets to copies.
fn assign(g: &mut Graph, tuning: Tuning, a: &Densify, lists: &Lists) -> Result<(), GraphError> {
    let Tuning { workgroup, .. } = tuning;
    let bindings = densify_slots::Bindings {
        before: lists.before.into(),
        verdicts: lists.verdicts.into(),
        hole_ranks: lists.holes.into(),
        holes: lists.hole_slots.into(),
    };
    let specs = densify_slots::Specs { workgroup };
    stage(g, "densify_slots", &densify_slots::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(lists.before, 0)?;

    let bindings = densify_assign::Bindings {
        before: lists.before.into(),
        plan: lists.plan.into(),
        verdicts: lists.verdicts.into(),
        holes: lists.hole_slots.into(),
        hole_ranks: lists.holes.into(),
        strong_ranks: lists.strong.into(),
        tie_ranks: lists.ties.into(),
        entries: lists.entries.into(),
        stats: a.stats.into(),
    };
    let specs = densify_assign::Specs { workgroup };
    stage(g, "densify_assign", &densify_assign::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(lists.before, 0)
}

/// List of copies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Copies {
    /// Their `Work` record.
    pub moves: Buffer,
    /// `Move` entries.
    pub entries: Buffer,
}

/// Adds the passes that copy columns and features of Gaussians.
pub(super) fn copy_columns(
    g: &mut Graph,
    tuning: Tuning,
    gaussians: &Handles,
    moments: &MomentHandles,
    list: Copies,
) -> Result<(), GraphError> {
    let Tuning { workgroup, .. } = tuning;
    let bindings = densify_move::Bindings {
        moves: list.moves.into(),
        entries: list.entries.into(),
        parameters: gaussians.parameters.into(),
        first_moments: moments.first.into(),
        second_moments: moments.second.into(),
    };
    let (columns, moment_columns, compact) = (gaussians.columns(), gaussians.model.columns(), gaussians.compact());
    let specs = densify_move::Specs { workgroup, columns, moment_columns, compact };
    stage(g, "densify_move", &densify_move::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(list.moves, 0)?;
    if !gaussians.model.semantics {
        return Ok(());
    }
    let bindings = densify_move_features::Bindings {
        moves: list.moves.into(),
        entries: list.entries.into(),
        features: gaussians.semantics.into(),
        moments: moments.semantics.into(),
    };
    let specs = densify_move_features::Specs { workgroup, width: Group::Semantics.width() };
    let kernel = &densify_move_features::KERNEL;
    stage(g, "densify_move_features", kernel, bindings.entries(), specs.entries(), &[]).dispatch_indirect(list.moves, 0)
}

/// Adds the passes that copy the Gaussians. The last pass separates the halves of each split.
fn copy(g: &mut Graph, tuning: Tuning, a: &Densify, lists: &Lists) -> Result<(), GraphError> {
    let Tuning { workgroup, .. } = tuning;
    let (columns, moment_columns, compact) = a.columns();
    copy_columns(g, tuning, &a.gaussians, &a.moments, Copies { moves: lists.moves, entries: lists.entries })?;
    let bindings = densify_split::Bindings {
        params: a.settings.into(),
        moves: lists.moves.into(),
        entries: lists.entries.into(),
        parameters: a.gaussians.parameters.into(),
    };
    let specs = splat_specs!(densify_split, tuning, { workgroup, columns, moment_columns, compact, });
    stage(g, "densify_split", &densify_split::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch_indirect(lists.moves, 0)
}

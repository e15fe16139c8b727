// Densification, step 5: assigns slots.
//
// Children take the holes from the lowest up, then the slots past the end. The k-th hole has at most k holes and all
// survivors before it, so with k below the number of new Gaussians it lies below the new end. As many holes remain below
// the new end as survivors lie beyond it; these move in, lowest into lowest. No Gaussian moves out of a slot that another
// moves into, so all copies can run concurrently.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, before);
IN(DensifyPlan, plan);
IN(uint, verdicts);
IN(uint, holes);
IN(uint, hole_ranks);
IN(uint, strong_ranks);
IN(uint, tie_ranks);
OUT(Move, entries); // the new Gaussians, then one for each slot beyond the new end
INOUT(DensifyStats, stats);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= before[0].count) return;
    DensifyPlan p = plan[0];
    uint verdict = verdicts[i];
    uint kind = verdict_kind(verdict);
    bool beyond = i >= p.after;
    if (kind == PRUNE) {
        if (beyond) entries[p.added + i - p.after] = Move(i, i, NOWHERE, PRUNE);
        return;
    }
    uint home = i;
    if (beyond) {
        uint rank = (i - hole_ranks[i]) - (p.after - hole_ranks[p.after]); // among the survivors beyond the new end
        home = holes[p.added + rank];
    }
    uint new_index = NOWHERE;
    if (refined(verdict)) {
        uint strength = verdict_strength(verdict);
        if (strength > p.cutoff) new_index = strong_ranks[i];
        else if (strength == p.cutoff && tie_ranks[i] < p.ties) new_index = p.strong + tie_ranks[i];
    }
    if (new_index != NOWHERE) {
        uint child = new_index < p.pruned ? holes[new_index] : p.before + (new_index - p.pruned);
        entries[new_index] = Move(i, home, child, kind);
        if (kind == SPLIT) atomicAdd(stats[0].split, 1u);
        else atomicAdd(stats[0].cloned, 1u);
    }
    if (beyond) entries[p.added + i - p.after] = Move(i, home, NOWHERE, new_index == NOWHERE ? KEEP : PRUNE);
}

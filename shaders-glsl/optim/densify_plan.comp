// Densification, step 2: computes the new count, and selects the Gaussians to refine if not all fit. One workgroup.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint PER_GROUP = 256;   // elements of a workgroup in the dispatches that follow
layout(constant_id = 2) const uint SCAN_BLOCK = 4096; // and in the prefix sums

layout(push_constant, scalar) uniform Push { uint capacity; } push;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(uint, counters);
INOUT(Work, live);
INOUT(uint, verdicts);
OUT(Work, before); // two: for the kernels here, and for the prefix sums
OUT(Work, moves);
OUT(DensifyPlan, plan);
OUT(DensifyStats, stats);

const uint SHARE = (STRENGTHS + WORKGROUP - 1u) / WORKGROUP;
shared uint shares[WORKGROUP]; // strongest first

uint count_of(uint strength) { return counters[COUNT_STRENGTHS + strength - 1u]; }

void main() {
    uint t = gl_LocalInvocationID.x;
    uint sum = 0u;
    for (uint k = t * SHARE; k < min((t + 1u) * SHARE, STRENGTHS); k++) sum += count_of(STRENGTHS - k);
    shares[t] = sum;
    barrier();
    if (t != 0u) return;

    DensifyPlan p;
    p.before = live[0].count;
    p.pruned = counters[COUNT_PRUNED];
    uint invalid = counters[COUNT_INVALID];
    if (p.before != 0u && p.pruned == p.before) {
        // Something must remain: the first whose numbers are finite, if there is one.
        uint spared = invalid == p.before ? 0u : ~counters[COUNT_SPARED];
        verdicts[spared] = KEEP;
        p.pruned--;
    }
    uint survivors = p.before - p.pruned;
    uint cap = min(params.densify.cap, push.capacity);
    uint candidates = counters[COUNT_REFINED];
    p.added = min(candidates, cap > survivors ? cap - survivors : 0u);
    p.after = survivors + p.added;
    p.cutoff = 0u;
    p.strong = candidates;
    if (p.added < candidates) {
        uint above = 0u, share = 0u;
        while (above + shares[share] <= p.added) above += shares[share++];
        uint strength = STRENGTHS - share * SHARE;
        while (above + count_of(strength) <= p.added) above += count_of(strength--);
        p.cutoff = strength;
        p.strong = above;
    }
    p.ties = p.added - p.strong;
    plan[0] = p;
    before[0] = work_for(p.before, PER_GROUP);
    before[1] = work_for(p.before, SCAN_BLOCK);
    moves[0] = work_for(max(p.added, p.pruned), PER_GROUP);
    live[0] = work_for(p.after, PER_GROUP);
    // Counts the spared Gaussian like the others.
    uint weightless = min(counters[COUNT_WEIGHTLESS], p.pruned - min(invalid, p.pruned));
    stats[0] = DensifyStats(p.before, p.after, p.pruned, invalid, weightless, 0u, 0u, candidates - p.added);
}

// Relocation, step 2: the new count, and how many Gaussians are drawn. One invocation.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"
#include "relocate.glsl"

layout(constant_id = 0) const uint PER_GROUP = 256; // elements of a workgroup in the dispatches that follow
layout(local_size_x = 1) in;

layout(push_constant, scalar) uniform Push { uint capacity; } push;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(uint, dead);    // their number
IN(uint, total);   // sum of weights
IN(uint, counters);
INOUT(Work, live);
OUT(Work, before);
OUT(Work, moves);
OUT(RelocatePlan, plan);
OUT(DensifyStats, stats);

const uint GROWTH = 20u; // one new Gaussian for this many

void main() {
    RelocatePlan p;
    p.before = live[0].count;
    p.total = total[0];
    // Nothing can be drawn where all are dead: they stay.
    bool any = p.total != 0u;
    p.dead = any ? dead[0] : 0u;
    uint wanted = any ? p.before + min(p.before / GROWTH, 0xffffffffu - p.before) : p.before;
    uint cap = max(min(params.densify.cap, push.capacity), p.before);
    uint after = min(wanted, cap);
    p.draws = p.dead + (after - p.before);
    plan[0] = p;
    before[0] = work_for(p.before, PER_GROUP);
    moves[0] = work_for(p.draws, PER_GROUP);
    live[0] = work_for(after, PER_GROUP);
    stats[0] = DensifyStats(p.before, after, p.dead, any ? counters[0] : 0u, 0u, p.draws, 0u, wanted - after);
}

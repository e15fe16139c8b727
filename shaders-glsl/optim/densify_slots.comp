// Densification, step 4: the slots of the pruned Gaussians, by rank.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, before);
IN(uint, verdicts);
IN(uint, hole_ranks);
OUT(uint, holes);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= before[0].count || verdict_kind(verdicts[i]) != PRUNE) return;
    holes[hole_ranks[i]] = i;
}

// Densification, step 3: the decisions as flags, whose prefix sums rank the Gaussians of each kind.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, before);
IN(DensifyPlan, plan);
IN(uint, verdicts);
OUT(uint, is_hole);
OUT(uint, is_strong);
OUT(uint, is_tie);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= before[0].count) return;
    uint verdict = verdicts[i];
    uint cutoff = plan[0].cutoff;
    is_hole[i] = uint(verdict_kind(verdict) == PRUNE);
    is_strong[i] = uint(refined(verdict) && verdict_strength(verdict) > cutoff);
    is_tie[i] = uint(refined(verdict) && verdict_strength(verdict) == cutoff);
}

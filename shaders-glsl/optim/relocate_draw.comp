// Relocation, step 4: draws a living Gaussian for each dead and each new one, in proportion to the weights.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"
#include "random.glsl"
#include "relocate.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(RelocatePlan, plan);
IN(uint, sums);      // of the weights of all Gaussians before
IN(uint, holes);     // slots of the dead
OUT(Move, entries);
INOUT(uint, copies); // by Gaussian: how often it is drawn

void main() {
    uint t = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    RelocatePlan p = plan[0];
    if (t >= p.draws) return;
    uint target, unused;
    umulExtended(random_bits(params.densify.seed ^ RANDOM_DRAW, t, 0u), p.total, target, unused);
    // The last Gaussian whose sum is at most the target. The next sum is above it, so the weight is not zero.
    uint low = 0u, high = p.before;
    while (high - low > 1u) {
        uint middle = low + (high - low) / 2u;
        if (sums[middle] <= target) low = middle;
        else high = middle;
    }
    uint child = t < p.dead ? holes[t] : p.before + (t - p.dead);
    entries[t] = Move(low, low, child, CLONE);
    atomicAdd(copies[low], 1u);
}

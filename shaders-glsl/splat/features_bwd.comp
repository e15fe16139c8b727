// Gradients of raw features: sums over the entries of each visible splat in order, added to those of other views. A step
// of one view fuses them with Adam instead (features_bwd_adam).
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint FEATURES = 32;
layout(constant_id = 2) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;

IN(Work, visible);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(float, entry_features); // [entries * (6 + FEATURES)], moments first
IN(uint, entry_flags);
INOUT(float, grad_features); // [Gaussians * FEATURES]; those that are not visible stay as they are

#include "entry_features.glsl"

void main() {
    uint own = folded_workgroup() * WORKGROUP + gl_SubgroupID * SUBGROUP + gl_SubgroupInvocationID;
    bool there = own < visible[0].count;
    uint id = there ? splat_ids[own] : 0u;
    EntrySplat mine = entry_splat(own, there);
    uvec4 exist = subgroupBallot(there);
    for (uint item = gl_SubgroupInvocationID; item < SUBGROUP * QUADS; item += SUBGROUP) {
        uint of = item / QUADS, c = item % QUADS * 4u;
        uint at = subgroupShuffle(id, of) * FEATURES + c;
        vec4 sum = entry_sum(mine, of, c);
        if (subgroupBallotBitExtract(exist, of) && sum != vec4(0.0)) {
            [[unroll]] for (uint k = 0u; k < 4u; ++k) grad_features[at + k] += sum[k];
        }
    }
}

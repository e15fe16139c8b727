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

#include "large_splats.glsl"
#include "entry_features.glsl"

void take(uint row, vec4 sum) {
    if (sum == vec4(0.0)) return;
    [[unroll]] for (uint k = 0u; k < 4u; ++k) grad_features[row + k] += sum[k];
}

void main() {
    uint own = folded_workgroup() * WORKGROUP + gl_SubgroupID * SUBGROUP + gl_SubgroupInvocationID;
    bool there = own < visible[0].count;
    uint id = there ? splat_ids[own] : 0u;
    EntrySplat mine = entry_splat(own, there);
    uvec4 exist = subgroupBallot(there && mine.large_count == 0u);
    for (uint item = gl_SubgroupInvocationID; item < SUBGROUP * QUADS; item += SUBGROUP) {
        uint of = item / QUADS, c = item % QUADS * 4u;
        uint row = subgroupShuffle(id, of) * FEATURES + c;
        vec4 sum = entry_sum(mine, of, c);
        if (subgroupBallotBitExtract(exist, of)) take(row, sum);
    }
    uvec4 large = subgroupBallot(mine.large_count != 0u);
    while (any(notEqual(large, uvec4(0u)))) {
        uint of = next_large(large);
        uint row = subgroupShuffle(id, of) * FEATURES + large_column();
        vec4 sum = large_entry_sum(mine, of);
        if (gl_SubgroupInvocationID < QUADS) take(row, sum);
    }
}

// Gradients of raw features summed over the entries of each visible splat, fused with Adam.
//
// A feature whose gradient is exactly zero counts as unseen and is left unchanged, unless Adam is dense. A non-finite
// gradient changes nothing and is counted. A raised flag leaves everything unchanged.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint FEATURES = 32;
layout(constant_id = 2) const uint SUBGROUP = 32;
layout(constant_id = 3) const bool DENSE = false; // then `seen` says which are left to another pass
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(uint, flags);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(float, entry_features); // [entries * (6 + FEATURES)], moments first
IN(uint, entry_flags);
IN(uint, seen);
INOUT(float, parameters);
INOUT(vec2, moments);
INOUT(uint, skipped); // counter of gradients that were not finite

#include "large_splats.glsl"
#include "entry_features.glsl"

// Updates four features. Returns how many of their gradients were not finite.
uint take(uint row, vec4 sum) {
    uint bad = 0u;
    if (!DENSE && sum == vec4(0.0)) return bad;
    [[unroll]] for (uint k = 0u; k < 4u; ++k) {
        if (!DENSE && is_zero(sum[k])) continue;
        if (!is_finite(sum[k])) {
            bad++;
            continue;
        }
        uint at = row + k;
        float parameter = parameters[at];
        vec2 m = moments[at];
        adam(parameter, m, sum[k], params.step.lr_semantics, params.step.correction1, params.step.correction2);
        parameters[at] = parameter;
        moments[at] = m;
    }
    return bad;
}

void main() {
    if (flags[0] != 0u) return;
    uint own = folded_workgroup() * WORKGROUP + gl_SubgroupID * SUBGROUP + gl_SubgroupInvocationID;
    bool there = own < visible[0].count;
    uint id = there ? splat_ids[own] : 0u;
    if (DENSE) there = there && seen[id] != 0u;
    EntrySplat mine = entry_splat(own, there);
    uvec4 exist = subgroupBallot(there && mine.large_count == 0u);
    uint bad = 0u;
    for (uint item = gl_SubgroupInvocationID; item < SUBGROUP * QUADS; item += SUBGROUP) {
        uint of = item / QUADS, c = item % QUADS * 4u;
        uint row = subgroupShuffle(id, of) * FEATURES + c;
        vec4 sum = entry_sum(mine, of, c);
        if (subgroupBallotBitExtract(exist, of)) bad += take(row, sum);
    }
    uvec4 large = subgroupBallot(mine.large_count != 0u);
    while (any(notEqual(large, uvec4(0u)))) {
        uint of = next_large(large);
        uint row = subgroupShuffle(id, of) * FEATURES + large_column();
        vec4 sum = large_entry_sum(mine, of);
        if (gl_SubgroupInvocationID < QUADS) bad += take(row, sum);
    }
    if (bad != 0u) atomicAdd(skipped[0], bad);
}

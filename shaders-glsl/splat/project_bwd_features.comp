// Backward of projection for gradients from features alone, for views whose loss reads only features.
//
// Sums moments over the entries of each visible splat in order, converts them to gradients of its place, shape and
// opacity, and adds these to those of other views.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "distortion.glsl"
#include "work.glsl"
#include "adam.glsl"
#include "splat.glsl"
#include "projection.glsl"
#include "gaussian.glsl"
#include "project_bwd.glsl"
#include "extra.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint FEATURES = 32;
layout(constant_id = 2) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
#include "large_splats.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(float, entry_features); // [entries * (6 + FEATURES)], moments first
IN(uint, entry_flags);
IN(vec4, parameters);
INOUT(float, extra); // [Gaussians * EXTRA_WIDTH]; splats that cover no selected pixel are unchanged

void add_entry(inout float moments[6], uint e) {
    if (entry_flags[e] == 0u) return;
    [[unroll]] for (uint j = 0u; j < 6u; ++j) moments[j] += entry_features[e * (6u + FEATURES) + j];
}

// Moments of the splat of each lane. A lane adds those of a small splat's entries in order; all lanes together add those
// of a large one's, each every SUBGROUP-th.
void sum_moments(uint first, uint count, out float moments[6]) {
    [[unroll]] for (uint j = 0u; j < 6u; ++j) moments[j] = 0.0;
    bool large = count > LARGE_TILES;
    uint last = large ? first : first + count;
    for (uint e = first; e < last; ++e) add_entry(moments, e);
    uvec4 votes = subgroupBallot(large);
    while (any(notEqual(votes, uvec4(0u)))) {
        uint lane = next_large(votes);
        uint begin = subgroupShuffle(first, lane), end = begin + subgroupShuffle(count, lane);
        float part[6];
        [[unroll]] for (uint j = 0u; j < 6u; ++j) part[j] = 0.0;
        for (uint e = begin + gl_SubgroupInvocationID; e < end; e += SUBGROUP) add_entry(part, e);
        [[unroll]] for (uint j = 0u; j < 6u; ++j) {
            float total = lane_tree_sum(part[j]);
            if (lane == gl_SubgroupInvocationID) moments[j] = total;
        }
    }
}

void main() {
    uint v = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    bool there = v < visible[0].count;
    float moments[6];
    sum_moments(there ? entry_starts[v] : 0u, there ? tile_counts[v] : 0u, moments);
    if (!there) return;
    uint any_gradient = 0u;
    [[unroll]] for (uint j = 0u; j < 6u; ++j) any_gradient |= magnitude_bits(moments[j]);
    if (any_gradient == 0u) return;
    uint i = splat_ids[v];
    vec4 place = parameters[column_of(i, 0u)];
    vec3 mean = place.xyz, log_scale = parameters[column_of(i, 1u)].xyz;
    Projection p;
    project_splat(params.step.camera, mean, log_scale, parameters[column_of(i, 2u)], place.w, p);
    SplatGradient g = project_gradient(params.step.camera, p, mean, log_scale, moments, 0.0);
    float values[EXTRA_WIDTH] = float[](g.mean.x, g.mean.y, g.mean.z, g.log_scale.x, g.log_scale.y, g.log_scale.z,
                                        g.rotation.x, g.rotation.y, g.rotation.z, g.rotation.w, g.opacity_logit);
    float check = 0.0;
    [[unroll]] for (uint j = 0u; j < EXTRA_WIDTH; ++j) check += values[j];
    // Where one number is not finite all of them go without: the optimizer skips each group by itself.
    float spoiled = is_finite(check) ? 0.0 : uintBitsToFloat(0x7fc00000u);
    [[unroll]] for (uint j = 0u; j < EXTRA_WIDTH; ++j) extra[i * EXTRA_WIDTH + j] += values[j] + spoiled;
}

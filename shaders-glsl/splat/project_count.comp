// Frustum-culls the Gaussians once for the whole step: one visibility bit each, and the count of each workgroup.
//
// This is the first half of compaction by reduce-then-scan. `project` follows these bits, since its own arithmetic may
// differ by an ulp.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "distortion.glsl"
#include "work.glsl"
#include "splat.glsl"
#include "projection.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256; // a multiple of 32
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, gaussians);
IN(vec4, parameters);
OUT(uint, visible_bits); // by Gaussian, 32 a word
OUT(uint, block_counts);

const uint WORDS = WORKGROUP / 32u;

// Votes by subgroup: a part of a word each, or several words. No subgroup has fewer than 8 lanes.
shared uint parts[(WORKGROUP + 7u) / 8u];

uint word_of(uint w) {
    if (SUBGROUP >= 32u) return parts[w];
    uint each = 32u / SUBGROUP, word = 0u;
    for (uint k = 0u; k < each; ++k) word |= parts[w * each + k] << (k * SUBGROUP);
    return word;
}

void main() {
    uint block = folded_workgroup();
    uint i = block * WORKGROUP + gl_SubgroupID * SUBGROUP + gl_SubgroupInvocationID;
    bool visible = false;
    if (i < gaussians[0].count) {
        vec4 place = parameters[column_of(i, 0u)], size = parameters[column_of(i, 1u)];
        vec4 rotation = parameters[column_of(i, 2u)];
        Projection p;
        if (project_splat(params.step.camera, place.xyz, size.xyz, rotation, place.w, p)) {
            visible = !box_is_empty(splat_box(p.splat, exponent_limit(p.splat), params.step.camera.size));
        }
    }
    uvec4 votes = subgroupBallot(visible);
    uint each = max(SUBGROUP / 32u, 1u);
    if (gl_SubgroupInvocationID < each) parts[gl_SubgroupID * each + gl_SubgroupInvocationID] = votes[gl_SubgroupInvocationID];
    barrier();
    if (block >= block_counts.length()) return;
    uint w = gl_LocalInvocationID.x;
    if (w < WORDS) visible_bits[block * WORDS + w] = word_of(w);
    if (w == 0u) {
        uint total = 0u;
        for (uint k = 0u; k < WORDS; ++k) total += bitCount(word_of(k));
        block_counts[block] = total;
    }
}

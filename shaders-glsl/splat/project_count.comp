// How many Gaussians of each workgroup can be seen: the first half of compaction by reduce-then-scan. Projection is
// cheap against the memory that flags of every Gaussian would cost, so the second half computes it again.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "splat.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, gaussians);
IN(vec3, means);
IN(vec3, log_scales);
IN(vec4, rotations);
IN(float, opacity_logits);
OUT(uint, block_counts);

const uint SUBGROUPS = (WORKGROUP + SUBGROUP - 1u) / SUBGROUP;

shared uint sums[SUBGROUPS];

void main() {
    uint block = folded_workgroup();
    uint i = block * WORKGROUP + gl_LocalInvocationID.x;
    bool visible = false;
    if (i < gaussians[0].count) {
        Projection p;
        if (project_splat(params.step.camera, means[i], log_scales[i], rotations[i], opacity_logits[i], p)) {
            visible = !box_is_empty(splat_box(p.splat, exponent_limit(p.splat), params.step.camera.size));
        }
    }
    uint sum = subgroupBallotBitCount(subgroupBallot(visible));
    if (subgroupElect()) sums[gl_SubgroupID] = sum;
    barrier();
    if (gl_LocalInvocationID.x == 0u) {
        uint total = 0u;
        for (uint s = 0u; s < gl_NumSubgroups; ++s) total += sums[s];
        if (block < block_counts.length()) block_counts[block] = total;
    }
}

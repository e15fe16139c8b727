// Adds the semantic losses to the step's record, which loss_sum wrote. One workgroup.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"
#include "loss_stats.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool SEMANTIC = true; // whether to add the sums of the training view
layout(constant_id = 3) const uint PAIRS = 0;       // pseudo-views

#define SUM_T vec3
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    uint semantic_count; // workgroups that wrote sums
    uint pair_count;     // likewise, for each pseudo-view
    uint pair_pitch;     // stride between the sums of two pseudo-views
} push;

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec3, semantic_sums);
IN(float, pair_sums); // PAIRS x pair_pitch
IN(Region, regions);  // of the training view, then of the pseudo-views
INOUT(LossStats, stats);

#include "region.glsl"

void main() {
    uint first = gl_LocalInvocationID.x;
    vec3 semantic = vec3(0.0);
    if (SEMANTIC) {
        for (uint i = first; i < push.semantic_count; i += WORKGROUP) semantic += semantic_sums[i];
        semantic = group_sum(semantic);
    }
    if (first != 0u) return;
    Step s = params.step;
    LossStats r = stats[0];
    if (SEMANTIC) {
        r.semantic = semantic.x / float(max(s.semantic_valid, 1u));
        r.semantic_class = semantic.y / float(max(s.semantic_labeled, 1u));
        r.semantic_excluded = uint(semantic.z);
        r.total += s.weight_semantic * r.semantic + s.weight_semantic_class * r.semantic_class;
    }
    if (PAIRS > 0u) {
        vec2 all = vec2(0.0);
        for (uint p = 0u; p < PAIRS; p++) {
            float direction[FEATURES];
            bool counts;
            float apart = region_distance(regions[1u + p], regions[0], direction, counts);
            if (!counts) continue;
            float entropy = 0.0;
            for (uint i = 0u; i < push.pair_count; i++) entropy += pair_sums[p * push.pair_pitch + i];
            all += vec2(apart, entropy / regions[1u + p].count);
            r.correspondence_pairs++;
        }
        all /= float(PAIRS);
        r.correspondence = all.x;
        r.correspondence_class = all.y;
        r.total += s.weight_correspondence * (all.x + all.y);
    }
    stats[0] = r;
}

// Dense Adam for the semantic features of the Gaussians that the fused update of a step did not move: their gradient is zero,
// and moments decay and carry the features on.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint WIDTH = 32; // features of a Gaussian

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, live);
IN(uint, flags);
IN(uint, seen); // nonzero for Gaussians that this pass must skip
INOUT(float, features);
INOUT(vec2, moments);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= live[0].count || flags[0] != 0u || seen[i] != 0u) return;
    for (uint k = 0u; k < WIDTH; ++k) {
        uint at = i * WIDTH + k;
        vec2 m = moments[at];
        // What never had a gradient stays exactly as it is.
        if (is_zero(m.x) && is_zero(m.y)) continue;
        float feature = features[at];
        adam(feature, m, 0.0, params.step.lr_semantics, params.step.correction1, params.step.correction2);
        features[at] = feature;
        moments[at] = m;
    }
}

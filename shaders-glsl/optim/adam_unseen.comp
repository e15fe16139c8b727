// Adam for the Gaussians that a step did not see: gradient zero, so moments decay and carry the parameters on. Dense
// Adam is this beside the fused update of those that were seen.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint WIDTH = 1; // scalars of a Gaussian
layout(constant_id = 2) const uint RATE = 0;  // which learning rate

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, live);
IN(uint, flags);
IN(uint, seen); // not zero for what the fused update moved
INOUT(float, parameters);
INOUT(vec2, moments);

float learning_rate() {
    switch (RATE) {
    case 0: return params.step.lr_means;
    case 1: return params.step.lr_scales;
    case 2: return params.step.lr_rotations;
    case 3: return params.step.lr_opacities;
    case 4: return params.step.lr_sh0;
    case 5: return params.step.lr_sh_rest;
    case 6: return params.step.lr_normals;
    default: return params.step.lr_semantics;
    }
}

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= live[0].count || flags[0] != 0u || seen[i] != 0u) return;
    float lr = learning_rate();
    for (uint j = i * WIDTH; j < (i + 1u) * WIDTH; ++j) {
        vec2 m = moments[j];
        // What never had a gradient stays exactly as it is.
        if (m.x == 0.0 && m.y == 0.0) continue;
        float parameter = parameters[j];
        adam(parameter, m, 0.0, lr, params.step.correction1, params.step.correction2);
        parameters[j] = parameter;
        moments[j] = m;
    }
}

// Adam for the Gaussians that the fused update of a step did not move.
//
// Their gradient is that of other views, or zero. Then either moments decay and carry the parameters on (dense Adam), or
// the Gaussians are left unchanged.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint WIDTH = 1; // scalars of a Gaussian
layout(constant_id = 2) const uint RATE = 0;  // which learning rate
layout(constant_id = 3) const uint STRIDE = 0; // of the rows of gradients; 0: there are none, all are zero
layout(constant_id = 4) const uint FIRST = 0;  // where this group's gradients begin in a row
layout(constant_id = 5) const bool SPARSE = false; // an exactly-zero gradient leaves its scalar untouched

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, live);
IN(uint, flags);
IN(uint, seen);      // nonzero for Gaussians that this pass must skip
IN(float, gradients);
INOUT(float, parameters);
INOUT(vec2, moments);
INOUT(uint, skipped); // Gaussians whose gradients were not finite

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
    if (STRIDE > 0u) {
        bool finite = true;
        for (uint k = 0u; k < WIDTH; ++k) finite = finite && is_finite(gradients[i * STRIDE + FIRST + k]);
        if (!finite) {
            atomicAdd(skipped[0], 1u);
            return;
        }
    }
    float lr = learning_rate();
    for (uint k = 0u; k < WIDTH; ++k) {
        float gradient = 0.0;
        if (STRIDE > 0u) gradient = gradients[i * STRIDE + FIRST + k];
        if (SPARSE && is_zero(gradient)) continue;
        uint j = i * WIDTH + k;
        vec2 m = moments[j];
        // What never had a gradient stays exactly as it is.
        if (is_zero(gradient) && is_zero(m.x) && is_zero(m.y)) continue;
        float parameter = parameters[j];
        adam(parameter, m, gradient, lr, params.step.correction1, params.step.correction2);
        parameters[j] = parameter;
        moments[j] = m;
    }
}

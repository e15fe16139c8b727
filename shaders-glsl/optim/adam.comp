// Adam for one parameter group with gradients in a buffer. Does nothing if a flag of the step is set; skips and counts
// gradients that are not finite.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint WIDTH = 1;          // scalars of an element
layout(constant_id = 2) const uint RATE = 0;           // which learning rate; see learning_rate()
layout(constant_id = 3) const bool SKIP_ZERO = true;   // exactly zero: the element was not seen; leave it untouched
layout(constant_id = 4) const uint FLAGS = 1;          // words of `flags`
layout(constant_id = 5) const float EPSILON = 1e-15;   // added to the root of the second moment

layout(push_constant, scalar) uniform Push {
    float rate; // for RATE 7 and 10
} push;

layout(scalar) uniform StepBlock { Step step; } params;

IN(Work, live);
IN(uint, flags);
IN(float, gradients);
INOUT(float, parameters);
INOUT(vec2, moments);
INOUT(uint, skipped); // counter

float learning_rate() {
    switch (RATE) {
    case 0: return params.step.lr_means;
    case 1: return params.step.lr_scales;
    case 2: return params.step.lr_rotations;
    case 3: return params.step.lr_opacities;
    case 4: return params.step.lr_sh0;
    case 5: return params.step.lr_sh_rest;
    case 6: return params.step.lr_normals;
    case 8: return params.step.lr_decoder;
    case 9: return params.step.lr_semantics;
    case 10: return push.rate * params.step.lr_share;
    default: return push.rate;
    }
}

void main() {
    uint raised = 0u;
    for (uint i = 0u; i < FLAGS; i++) raised |= flags[i];
    if (raised != 0u) return;
    uint count = live[0].count * WIDTH;
    float lr = learning_rate();
    uint stride = gl_NumWorkGroups.x * gl_NumWorkGroups.y * WORKGROUP;
    uint bad = 0u;
    for (uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x; i < count; i += stride) {
        float gradient = gradients[i];
        if (SKIP_ZERO && is_zero(gradient)) continue;
        if (!is_finite(gradient)) {
            bad++;
            continue;
        }
        float parameter = parameters[i];
        vec2 m = moments[i];
        adam(parameter, m, gradient, lr, params.step.correction1, params.step.correction2, EPSILON);
        parameters[i] = parameter;
        moments[i] = m;
    }
    if (bad != 0u) atomicAdd(skipped[0], bad);
}

// Adam for the visibility field's layers. Gradients that are not finite change nothing and are counted.
#version 460
#include "common.glsl"
#include "visibility_grid.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint FLAGS = 1; // words of `flags`

layout(push_constant, scalar) uniform Push {
    uint count; // of weights
} push;

layout(scalar) uniform FieldBlock { FieldStep field; } params;

IN(uint, flags);
IN(float, mlp_gradient);
INOUT(float, mlp);
INOUT(vec2, moments);
INOUT(uint, skipped); // counter

void main() {
    uint raised = 0u;
    for (uint i = 0u; i < FLAGS; i++) raised |= flags[i];
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (raised != 0u || i >= push.count) return;
    float gradient = mlp_gradient[i];
    if (is_zero(gradient)) return;
    if (!is_finite(gradient)) {
        atomicAdd(skipped[0], 1u);
        return;
    }
    float parameter = mlp[i];
    vec2 m = moments[i];
    adam(parameter, m, gradient, params.field.rate, params.field.correction1, params.field.correction2);
    mlp[i] = parameter;
    moments[i] = m;
}

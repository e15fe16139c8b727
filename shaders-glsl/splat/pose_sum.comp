// Sums the workgroups' camera gradients in order.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 32;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint per_group; } push;

IN(Work, visible);
IN(float, pose_partials);
OUT(float, pose_gradient); // rows of the rotation, then the translation

void main() {
    uint j = gl_LocalInvocationID.x;
    if (j >= 12u) return;
    uint count = visible[0].count;
    uint groups = count / push.per_group + uint(count % push.per_group != 0u);
    float sum = 0.0;
    for (uint g = 0u; g < groups; ++g) sum += pose_partials[12u * g + j];
    pose_gradient[j] = sum;
}

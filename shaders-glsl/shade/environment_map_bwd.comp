// Adjoint of environment_map: gathers gradients of the map's pixels at the texels that they sampled.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint texels;
    float weight;
} push;

IN(float, slopes);      // [pixels * 3]
IN(uint, row_starts);   // [texels + 1]
IN(uvec2, row_entries); // pixel, bits of its weight
OUT(float, gradient);   // [texels * 3]

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= push.texels) return;
    vec3 sum = vec3(0.0);
    uint end = row_starts[i + 1u];
    for (uint e = row_starts[i]; e < end; e++) {
        uvec2 entry = row_entries[e];
        uint at = 3u * entry.x;
        sum += uintBitsToFloat(entry.y) * vec3(slopes[at], slopes[at + 1u], slopes[at + 2u]);
    }
    sum *= push.weight;
    gradient[3u * i] = sum.x;
    gradient[3u * i + 1u] = sum.y;
    gradient[3u * i + 2u] = sum.z;
}

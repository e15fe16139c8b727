// Quadratic smoothness of the environment's texels, zero for constants, and its gradient.
//
// Only differences occur: weight sum_i sum_j -1/2 q_ij |x_i - x_j|^2, so nothing cancels where the environment is bright
// and even.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

#define SUM_T float
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    uint texels;
    float weight;
} push;

IN(float, texels);      // [texels * 3]
IN(uint, row_starts);   // [texels + 1]
IN(uvec2, row_entries); // column, bits of the coefficient
OUT(float, gradient);   // [texels * 3]
OUT(float, sums);       // by workgroup, without the weight

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    float value = 0.0;
    if (i < push.texels) {
        vec3 own = vec3(texels[3u * i], texels[3u * i + 1u], texels[3u * i + 2u]);
        vec3 slope = vec3(0.0);
        uint end = row_starts[i + 1u];
        for (uint e = row_starts[i]; e < end; e++) {
            uvec2 entry = row_entries[e];
            float q = uintBitsToFloat(entry.y);
            vec3 d = vec3(texels[3u * entry.x], texels[3u * entry.x + 1u], texels[3u * entry.x + 2u]) - own;
            slope += q * d;
            value -= 0.5 * q * dot(d, d);
        }
        slope *= 2.0 * push.weight;
        gradient[3u * i] = slope.x;
        gradient[3u * i + 1u] = slope.y;
        gradient[3u * i + 2u] = slope.z;
    }
    float total = group_sum(value);
    uint group = folded_workgroup();
    if (gl_LocalInvocationID.x == 0u && group < sums.length()) sums[group] = total;
}

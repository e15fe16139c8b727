// Squared differences of neighbors in a latitude-longitude map, down and to the right, and the gradient by its pixels.
//
// The map wraps around to the right. Only differences occur, so nothing cancels where the environment is bright and even.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

#define SUM_T float
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    uvec2 size;
    float across; // weights of the two kinds of differences
    float down;
} push;

IN(float, map);     // [pixels * 3]
OUT(float, slopes); // [pixels * 3]
OUT(float, sums);   // by workgroup

vec3 pixel(uint x, uint y) {
    uint at = 3u * (y * push.size.x + x);
    return vec3(map[at], map[at + 1u], map[at + 2u]);
}

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    float value = 0.0;
    if (i < push.size.x * push.size.y) {
        uint x = i % push.size.x, y = i / push.size.x, last = push.size.x - 1u;
        vec3 own = pixel(x, y);
        vec3 right = own - pixel(x == last ? 0u : x + 1u, y), left = own - pixel(x == 0u ? last : x - 1u, y);
        vec3 below = y + 1u < push.size.y ? own - pixel(x, y + 1u) : vec3(0.0);
        vec3 above = y > 0u ? own - pixel(x, y - 1u) : vec3(0.0);
        value = push.across * dot(right, right) + push.down * dot(below, below);
        vec3 slope = 2.0 * (push.across * (right + left) + push.down * (below + above));
        slopes[3u * i] = slope.x;
        slopes[3u * i + 1u] = slope.y;
        slopes[3u * i + 2u] = slope.z;
    }
    float total = group_sum(value);
    uint group = folded_workgroup();
    if (gl_LocalInvocationID.x == 0u && group < sums.length()) sums[group] = total;
}

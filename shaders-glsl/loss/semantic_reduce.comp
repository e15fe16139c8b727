// Sums the partial results of several workgroups in a fixed order.
//
// Adds to the destination or replaces it. PARTS invocations share a sum if many workgroups wrote partial results.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool ADD = true;
layout(constant_id = 3) const uint PARTS = 8; // invocations per sum

layout(push_constant, scalar) uniform Push {
    uint width;  // sums per workgroup
    uint groups;
} push;

IN(float, partials); // groups x width
INOUT(float, accumulated);

const uint LANES = WORKGROUP / PARTS;

shared float parts[PARTS * LANES];

void main() {
    uint lane = gl_LocalInvocationID.x % LANES, part = gl_LocalInvocationID.x / LANES;
    uint at = folded_workgroup() * LANES + lane;
    float sum = 0.0;
    if (at < push.width) {
        for (uint g = part; g < push.groups; g += PARTS) sum += partials[g * push.width + at];
    }
    if (PARTS > 1u) {
        parts[gl_LocalInvocationID.x] = sum;
        barrier();
        sum = 0.0;
        for (uint p = 0u; p < PARTS; p++) sum += parts[p * LANES + lane];
    }
    if (part != 0u || at >= push.width) return;
    accumulated[at] = ADD ? accumulated[at] + sum : sum;
}

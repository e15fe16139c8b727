// Sums the rows that lights_bwd's workgroups left, in order. PARTS invocations share a number if there are many rows.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint PARTS = 8;

layout(push_constant, scalar) uniform Push {
    uint width; // numbers of a row
    uint rows;
} push;

IN(float, partials); // rows x width
OUT(float, light_gradients);

const uint LANES = WORKGROUP / PARTS;

shared float parts[PARTS * LANES];

void main() {
    uint lane = gl_LocalInvocationID.x % LANES, part = gl_LocalInvocationID.x / LANES;
    uint at = folded_workgroup() * LANES + lane;
    float sum = 0.0;
    if (at < push.width) {
        for (uint r = part; r < by_workgroup(push.rows); r += PARTS) sum += partials[r * push.width + at];
    }
    parts[gl_LocalInvocationID.x] = sum;
    barrier();
    if (part != 0u || at >= push.width) return;
    sum = 0.0;
    [[unroll]] for (uint p = 0u; p < PARTS; p++) sum += parts[p * LANES + lane];
    light_gradients[at] = sum;
}

// Counts each digit in each block: the first third of a pass of the radix sort.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint ITEMS = 16;
layout(constant_id = 2) const uint BITS = 8;
// Counters of a digit. Each belongs to as many invocations in a row; to one alone, it needs no atomics.
layout(constant_id = 3) const uint COPIES = 8;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint limit; uint shift; uint stride; } push;

#include "../prim/count.glsl"
const uint BINS = 1u << BITS;
IN(uint, keys);
OUT(uint, counts); // by digit, `stride` words each, then by block

shared uint bins[BINS * COPIES];

void main() {
    uint count = element_count();
    uint block = folded_workgroup();
    uint first = block * WORKGROUP * ITEMS;
    if (first >= count) return;
    uint end = min(first + WORKGROUP * ITEMS, count);
    for (uint i = gl_LocalInvocationID.x; i < BINS * COPIES; i += WORKGROUP) bins[i] = 0u;
    barrier();
    uint copy = gl_LocalInvocationID.x / (WORKGROUP / COPIES) * BINS;
    for (uint k = 0u; k < ITEMS; ++k) {
        uint i = first + k * WORKGROUP + gl_LocalInvocationID.x;
        if (i < end) {
            uint bin = copy + ((keys[i] >> push.shift) & (BINS - 1u));
            if (COPIES == WORKGROUP) {
                bins[bin] += 1u;
            } else {
                atomicAdd(bins[bin], 1u);
            }
        }
    }
    barrier();
    for (uint digit = gl_LocalInvocationID.x; digit < BINS; digit += WORKGROUP) {
        uint sum = 0u;
        for (uint c = 0u; c < COPIES; ++c) sum += bins[c * BINS + digit];
        counts[digit * push.stride + block] = sum;
    }
}

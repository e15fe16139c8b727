// Adds one to a word per invocation and round: the probe of atomic additions of the benchmark.
//
// `words` is a power of two and the number of invocations. Neighboring invocations add to neighboring words. Each round
// moves all of them by `stride` words, so every word gets one addition a round.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint words; uint rounds; uint stride; } push;

INOUT(uint, sums);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    for (uint k = 0u; k < push.rounds; ++k) atomicAdd(sums[(i + k * push.stride) & (push.words - 1u)], 1u);
}

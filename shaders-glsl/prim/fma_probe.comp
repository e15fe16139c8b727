// Arithmetic probe of the benchmark: eight independent chains of multiply-adds that touch no memory until the end, to
// hide latency. Each invocation does 128 operations a round.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint rounds; float factor; float summand; } push;

OUT(float, result);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    vec4 a = vec4(float(i), 1.0, 2.0, 3.0);
    vec4 b = a + 4.0;
    for (uint k = 0u; k < push.rounds; ++k) {
        [[unroll]] for (uint j = 0u; j < 8u; ++j) {
            a = a * push.factor + push.summand;
            b = b * push.factor + push.summand;
        }
    }
    vec4 sum = a + b;
    result[i] = sum.x + sum.y + sum.z + sum.w;
}

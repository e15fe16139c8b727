// Sets `count` words to a value. Also a probe of the benchmark.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint count; uint value; } push;

OUT(uint, target);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i < push.count) target[i] = push.value;
}

// Copies `count` pieces of 16 bytes: the probe of memory bandwidth of the benchmark.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint count; } push;

IN(uvec4, source);
OUT(uvec4, target);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i < push.count) target[i] = source[i];
}

// Clamps negative texels to 0.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint count;
} push;

INOUT(float, texels);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i < push.count && texels[i] < 0.0) texels[i] = 0.0;
}

// One mip of a cube: means of two by two texels.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint size; // texels along a side of the mip
} push;

IN(float, finer);
OUT(float, coarser);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= 6u * push.size * push.size) return;
    uint x = i % push.size, row = i / push.size; // faces follow each other, so rows do
    uint at = 6u * (2u * push.size * row + x), below = at + 6u * push.size;
    for (uint c = 0u; c < 3u; c++) {
        coarser[3u * i + c] = 0.25 * (finer[at + c] + finer[at + 3u + c] + finer[below + c] + finer[below + 3u + c]);
    }
}

// Backward of environment_mips: adds each mip's gradients to the texels of the cube.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint PARTS = 6;

layout(push_constant, scalar) uniform Push {
    uint size;      // of the cube
    uint first[8];  // first texel of each part
    uint shift[8];  // how often it was halved
} push;

IN(float, mip_gradients); // parts one after the other
OUT(float, gradient);     // [6 size^2 * 3]

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= 6u * push.size * push.size) return;
    uint x = i % push.size, y = i / push.size % push.size, face = i / (push.size * push.size);
    vec3 sum = vec3(0.0);
    [[unroll]] for (uint p = 0u; p < PARTS; p++) {
        uint shift = push.shift[p], side = push.size >> shift;
        uint at = 3u * (push.first[p] + (face * side + (y >> shift)) * side + (x >> shift));
        float share = 1.0 / float(1u << (2u * shift));
        sum += share * vec3(mip_gradients[at], mip_gradients[at + 1u], mip_gradients[at + 2u]);
    }
    gradient[3u * i] = sum.x;
    gradient[3u * i + 1u] = sum.y;
    gradient[3u * i + 2u] = sum.z;
}

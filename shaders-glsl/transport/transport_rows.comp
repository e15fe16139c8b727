// Rows of the transport matrix as bounces read them: targets of BITS bits, rows of whole words of 16 bytes.
//
// Rays that meet nothing, and the rest of a row, get the number after the last receiver's, whose values are zero.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(constant_id = 1) const uint BITS = 16; // of a target: 16 or 32
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint rays;
    uint width; // of a row, in words of 4 bytes
} push;

IN(uint, targets);      // [receivers][rays]
OUT(uint, matrix_rows); // [receivers][width]

uint target_of(uint receiver, uint ray) {
    uint met = ray < push.rays ? targets[receiver * push.rays + ray] : push.receivers;
    return min(met, push.receivers);
}

void main() {
    uint at = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (at >= push.receivers * push.width) return;
    uint receiver = at / push.width, word = at % push.width;
    matrix_rows[at] = BITS == 16u ? target_of(receiver, 2u * word) | target_of(receiver, 2u * word + 1u) << 16u
                                  : target_of(receiver, word);
}

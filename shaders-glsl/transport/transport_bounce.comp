// One bounce of light: radiosity of every receiver from that of the receivers that its rays meet. See transport_step.glsl.
#version 460
#include "common.glsl"
#include "transport_images.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(constant_id = 1) const uint LANES = 8;  // of a receiver
layout(constant_id = 2) const uint BITS = 16;  // of a target: 16 or 32
layout(constant_id = 3) const uint WIDTH = 8;  // of a row of the matrix, in words of 16 bytes; a constant unrolls the loop
layout(local_size_x_id = 0) in;
#include "transport_step.glsl"

IN(uvec4, matrix_rows); // [receivers][WIDTH]

vec3 transport_gather(uint receiver, uint light, uint lane) {
    vec3 sum = vec3(0.0);
    for (uint k = lane; k < WIDTH; k += LANES) {
        uvec4 words = matrix_rows[receiver * WIDTH + k];
        [[unroll]] for (uint j = 0u; j < 128u / BITS; j++) {
            uint met = BITS == 16u ? words[j / 2u] >> 16u * (j & 1u) & 0xffffu : words[j & 3u];
            sum += imageLoad(current, transport_texel(met, light, push.rows)).xyz;
        }
    }
    return sum;
}

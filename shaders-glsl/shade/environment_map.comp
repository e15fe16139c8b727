// Resamples an environment cube bilinearly at each pixel of a latitude-longitude map.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint pixels; } push;

IN(float, texels);    // [texels * 3]
IN(uint, footprints); // [pixels * 8]: four texels, bits of their four weights
OUT(float, map);      // [pixels * 3]

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= push.pixels) return;
    vec3 sum = vec3(0.0);
    [[unroll]] for (uint k = 0u; k < 4u; k++) {
        uint at = 3u * footprints[8u * i + k];
        sum += uintBitsToFloat(footprints[8u * i + 4u + k]) * vec3(texels[at], texels[at + 1u], texels[at + 2u]);
    }
    map[3u * i] = sum.x;
    map[3u * i + 1u] = sum.y;
    map[3u * i + 2u] = sum.z;
}

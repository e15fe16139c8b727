// Regularizers of the lights: distance from surfaces, and total brightness. One workgroup.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;
layout(constant_id = 2) const bool FREE = false;

#define SUM_T vec2
#include "group_sum.glsl"
#include "lights.glsl"

layout(push_constant, scalar) uniform Push {
    uint lights;
    uint groups; // that left partial results
} push;

IN(uint, near_partials);
IN(float, lobes);
IN(float, gains);
OUT(uint, nearest);       // by light: distance squared (as bits), pixel
OUT(float, light_losses); // mean of 1 / max(d^2, 1e-3), 3 times the mean of the amplitudes

#include "light_axis.glsl"

void main() {
    vec2 sum = vec2(0.0);
    for (uint light = gl_LocalInvocationID.x; light < by_workgroup(push.lights); light += WORKGROUP) {
        float square = uintBitsToFloat(0x7f800000u);
        uint pixel = 0xffffffffu;
        for (uint g = 0u; g < push.groups; g++) {
            uint at = 2u * (g * push.lights + light);
            float s = uintBitsToFloat(near_partials[at]);
            uint p = near_partials[at + 1u];
            bool nearer = s < square || (s == square && p < pixel);
            square = nearer ? s : square;
            pixel = nearer ? p : pixel;
        }
        nearest[2u * light] = floatBitsToUint(square);
        nearest[2u * light + 1u] = pixel;
        if (gains[light] != 0.0 && pixel != 0xffffffffu) sum.x += 1.0 / max(square, NEAR_SQUARED);
    }
    for (uint item = gl_LocalInvocationID.x; item < push.lights * LOBES; item += WORKGROUP) {
        vec3 a = lobe_amplitude(load_raw_lobe(item).amplitude);
        if (gains[item / LOBES] != 0.0) sum.y += (a.r + a.g + a.b) / float(LOBES);
    }
    sum = group_sum(sum) / float(push.lights);
    if (gl_LocalInvocationID.x == 0u) {
        light_losses[0] = sum.x;
        light_losses[1] = sum.y;
    }
}

// Sums albedo over the pixels of a region.
//
// One invocation processes one word of the mask, since most words are either empty or full.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

#define SUM_T vec4
#include "group_sum.glsl"

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec3, albedo_srgb); // P
IN(uint, mask);        // one bit per pixel, from word mask_offset
OUT(vec4, sums);       // by workgroup: albedo, number of pixels

void main() {
    uint pixels = params.step.camera.size.x * params.step.camera.size.y;
    uint group = folded_workgroup(), word = group * WORKGROUP + gl_LocalInvocationID.x;
    vec4 sum = vec4(0.0);
    if (32u * word < pixels) {
        uint left = pixels - 32u * word, bits = mask[params.step.mask_offset + word];
        if (left < 32u) bits &= (1u << left) - 1u;
        while (bits != 0u) {
            uint bit = uint(findLSB(bits));
            sum += vec4(albedo_srgb[32u * word + bit], 1.0);
            bits &= bits - 1u;
        }
    }
    sum = group_sum(sum);
    if (gl_LocalInvocationID.x == 0u && group < sums.length()) sums[group] = sum;
}

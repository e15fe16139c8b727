// Sums of the features over a region, and how many of its pixels have which class.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 128;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;
layout(constant_id = 3) const uint CHANNELS = 35;
layout(constant_id = 4) const uint FIRST = 3;
layout(constant_id = 5) const bool CLASSIFY = true; // false: the histogram stays as it is

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(uint, mask);            // a bit a pixel
IN(float, text);           // CLASSES x 33
OUT(float, region_sums);   // by workgroup: 32 features, number of pixels
INOUT(uint, histogram);    // CLASSES

shared uint counts[CLASSES];
shared float subgroup_sums[AUGMENTED * ((WORKGROUP + 7u) / 8u)];

void main() {
    uvec2 size = params.step.camera.size;
    uint pixels = size.x * size.y;
    if (CLASSIFY) {
        for (uint c = gl_LocalInvocationID.x; c < CLASSES; c += WORKGROUP) counts[c] = 0u;
        barrier();
    }
    float sums[AUGMENTED];
    [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) sums[k] = 0.0;
    for (uint first = gl_WorkGroupID.x * WORKGROUP; first < pixels; first += gl_NumWorkGroups.x * WORKGROUP) {
        uint pixel = first + gl_LocalInvocationID.x;
        if (pixel >= pixels || (mask[params.step.mask_offset + pixel / 32u] >> pixel % 32u & 1u) == 0u) continue;
        float f[FEATURES];
        bool finite = true;
        [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
            f[k] = image[pixel * CHANNELS + FIRST + k];
            finite = finite && finite_bits(f[k]);
        }
        if (!finite) continue;
        [[unroll]] for (uint k = 0u; k < FEATURES; k++) sums[k] += f[k];
        sums[FEATURES] += 1.0;
        if (CLASSIFY) {
            // Huge features are brought down first, so that no product overflows.
            float largest = 1.0;
            [[unroll]] for (uint k = 0u; k < FEATURES; k++) largest = max(largest, abs(f[k]));
            [[unroll]] for (uint k = 0u; k < FEATURES; k++) f[k] /= largest;
            float best = -1e38;
            uint label = 0u;
            for (uint c = 0u; c < CLASSES; c++) {
                float product = text[c * AUGMENTED + FEATURES] / largest;
                [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
                    product = fma(text[c * AUGMENTED + k], f[k], product);
                }
                if (product > best) {
                    best = product;
                    label = c;
                }
            }
            atomicAdd(counts[label], 1u);
        }
    }
    [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) {
        float sum = subgroupAdd(sums[k]);
        if (subgroupElect()) subgroup_sums[k * ((WORKGROUP + 7u) / 8u) + gl_SubgroupID] = sum;
    }
    barrier();
    for (uint k = gl_LocalInvocationID.x; k < AUGMENTED; k += WORKGROUP) {
        float total = 0.0;
        for (uint i = 0u; i < gl_NumSubgroups; i++) total += subgroup_sums[k * ((WORKGROUP + 7u) / 8u) + i];
        region_sums[gl_WorkGroupID.x * AUGMENTED + k] = total;
    }
    if (CLASSIFY) {
        for (uint c = gl_LocalInvocationID.x; c < CLASSES; c += WORKGROUP) {
            if (counts[c] != 0u) atomicAdd(histogram[c], counts[c]);
        }
    }
}

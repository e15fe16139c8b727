// What the pseudo-views' regions ask of the training view's mean features, added to the gradient of its region.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CHANNELS = 35;
layout(constant_id = 3) const uint FIRST = 3;
layout(constant_id = 4) const uint PAIRS = 2; // pseudo-views

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(uint, mask);
IN(Region, regions); // the training view's, then the pseudo-views'
INOUT(float, grad_image);

#include "region.glsl"

shared float wanted[FEATURES];

void main() {
    if (gl_LocalInvocationID.x == 0u) {
        float total[FEATURES];
        [[unroll]] for (uint k = 0u; k < FEATURES; k++) total[k] = 0.0;
        for (uint p = 0u; p < PAIRS; p++) {
            float direction[FEATURES];
            bool counts;
            region_distance(regions[0], regions[1u + p], direction, counts);
            [[unroll]] for (uint k = 0u; k < FEATURES; k++) total[k] += direction[k];
        }
        float weight = params.step.weight_correspondence / (float(PAIRS) * max(regions[0].count, 1.0));
        [[unroll]] for (uint k = 0u; k < FEATURES; k++) wanted[k] = weight * total[k];
    }
    barrier();
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    if ((mask[params.step.mask_offset + pixel / 32u] >> pixel % 32u & 1u) == 0u) return;
    uint at = pixel * CHANNELS + FIRST;
    bool finite = true;
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) finite = finite && finite_bits(image[at + k]);
    if (!finite) return;
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) grad_image[at + k] += wanted[k];
}

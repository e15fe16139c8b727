// The correspondence loss of one pseudo-view: its region's pixels should have the class of the training view's region,
// and its mean features should be the same. Writes the gradient of all pixels, zero outside the region.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 128;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;
layout(constant_id = 3) const uint CHANNELS = 35;
layout(constant_id = 4) const uint FIRST = 3;

#define SUM_T float
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push { float share; } push; // of this pseudo-view in the weight

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(uint, mask);
IN(float, gram);
IN(float, text);
IN(Region, trained); // the training view's
IN(Region, region);  // this one's
OUT(float, grad_image);
INOUT(float, partials);
OUT(float, sums);    // cross-entropy by workgroup

#include "semantic_chunk.glsl"
#include "region.glsl"

void main() {
    uvec2 size = params.step.camera.size;
    uint pixels = size.x * size.y;
    float direction[FEATURES];
    bool counts;
    region_distance(region[0], trained[0], direction, counts);
    uint label = trained[0].majority;
    float weight = counts ? params.step.weight_correspondence * push.share / region[0].count : 0.0;
    float sum = 0.0;
    for (uint first = gl_WorkGroupID.x * WORKGROUP; first < pixels; first += gl_NumWorkGroups.x * WORKGROUP) {
        uint pixel = first + gl_LocalInvocationID.x;
        float f[AUGMENTED], u[AUGMENTED], a[FEATURES];
        float inverse = 0.0;
        [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) f[k] = u[k] = 0.0;
        [[unroll]] for (uint k = 0u; k < FEATURES; k++) a[k] = 0.0;
        bool live = counts && pixel < pixels
                 && (mask[params.step.mask_offset + pixel / 32u] >> pixel % 32u & 1u) != 0u;
        if (live) {
            [[unroll]] for (uint k = 0u; k < FEATURES; k++) f[k] = image[pixel * CHANNELS + FIRST + k];
            live = decode(f, u, inverse);
        }
        sum += add_chunk(live, f, u, inverse, weight, label, 0.0, a);
        if (pixel < pixels) {
            [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
                float g = live ? fma(weight, direction[k], a[k] * f[FEATURES]) : 0.0;
                grad_image[pixel * CHANNELS + FIRST + k] = g;
            }
        }
    }
    float total = group_sum(sum);
    if (gl_LocalInvocationID.x == 0u) sums[gl_WorkGroupID.x] = total;
}

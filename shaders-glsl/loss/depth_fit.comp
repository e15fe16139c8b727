// Sums with which prior depths are fitted to the blended depth of a view. Each workgroup takes a share of the pixels.
//
// The fit is a weighted least-squares line through pairs of prior value and inverse blended depth. The weight is the
// confidence of the prior times the opacity.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CHANNELS = 8; // floats of a pixel of the image
layout(constant_id = 3) const uint DEPTH_AT = 6; // channel of depth

#define SUM_T vec4
#include "group_sum.glsl"

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(float, transmittance);
IN(uint, depth_priors); // half floats: prior value and confidence
OUT(vec4, sums);        // by workgroup: w, w x, w y, w x x; then w x y in x

// Pixels that show little have a depth, but not that of a surface.
const float LEAST_OPACITY = 0.5;

void main() {
    uint pixels = params.step.camera.size.x * params.step.camera.size.y;
    vec4 sum = vec4(0.0);
    float product = 0.0;
    uint all = gl_NumWorkGroups.x * WORKGROUP;
    for (uint pixel = gl_GlobalInvocationID.x; pixel < pixels; pixel += all) {
        vec2 prior = unpackHalf2x16(depth_priors[params.step.target_offset + pixel]);
        float opacity = 1.0 - transmittance[pixel], depth = image[pixel * CHANNELS + DEPTH_AT];
        if (prior.y > 0.0 && opacity >= LEAST_OPACITY && depth > 0.0) {
            float w = prior.y * opacity, x = prior.x, y = opacity / depth;
            sum += vec4(w, w * x, w * y, w * x * x);
            product += w * x * y;
        }
    }
    sum = group_sum(sum);
    barrier(); // before the shared sums are written again
    product = group_sum(vec4(product)).x;
    if (gl_LocalInvocationID.x == 0u) {
        sums[2u * gl_WorkGroupID.x] = sum;
        sums[2u * gl_WorkGroupID.x + 1u] = vec4(product, 0.0, 0.0, 0.0);
    }
}

// Backward of `view_gain`: the gradient by its result becomes the one by its input. Sums those by the factors' logarithms.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "learned_view.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint CHANNELS = 3;
layout(constant_id = 2) const bool LENS = false; // whether the lens darkens corners
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(LearnedView, views);
IN(float, image);        // with the factors
INOUT(float, grad_image);
OUT(float, gain_parts);  // [workgroups * 3], or 4 with the lens

#define SUM_T vec4
#include "group_sum.glsl"

void main() {
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    vec4 by_log = vec4(0.0); // by the factors on red, green and blue, and by the vignetting
    if (pixel < params.step.camera.size.x * params.step.camera.size.y) {
        vec3 gain = learned_vector(views[params.step.view], VIEW_GAIN);
        float share = LENS ? corner_share(params.step.camera.size, pixel) : 0.0;
        if (LENS) gain += views[views.length() - 1u].values[LENS_VIGNETTING] * share;
        gain = exp(gain);
        [[unroll]] for (uint c = 0u; c < 3u; ++c) {
            uint at = pixel * CHANNELS + c;
            float gradient = grad_image[at];
            by_log[c] = gradient * image[at];
            grad_image[at] = gradient * gain[c];
        }
        by_log.w = share * (by_log.x + by_log.y + by_log.z);
    }
    const uint WIDTH = LENS ? 4u : 3u;
    vec4 sum = group_sum(by_log);
    if (gl_LocalInvocationID.x == 0u) {
        // Folded grids have empty workgroups at their end.
        uint at = WIDTH * folded_workgroup();
        [[unroll]] for (uint c = 0u; c < WIDTH; ++c) {
            if (at + c < gain_parts.length()) gain_parts[at + c] = sum[c];
        }
    }
}

// Backward of `view_gain`: the gradient by its result becomes the one by its input. Sums those by the factors' logarithms.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "learned_view.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint CHANNELS = 3;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(LearnedView, views);
IN(float, image);        // with the factors
INOUT(float, grad_image);
OUT(float, gain_parts);  // [workgroups * 3]

#define SUM_T vec3
#include "group_sum.glsl"

void main() {
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    vec3 by_log = vec3(0.0);
    if (pixel < params.step.camera.size.x * params.step.camera.size.y) {
        vec3 gain = exp(learned_vector(views[params.step.view], VIEW_GAIN));
        [[unroll]] for (uint c = 0u; c < 3u; ++c) {
            uint at = pixel * CHANNELS + c;
            float gradient = grad_image[at];
            by_log[c] = gradient * image[at];
            grad_image[at] = gradient * gain[c];
        }
    }
    vec3 sum = group_sum(by_log);
    if (gl_LocalInvocationID.x == 0u) {
        // Folded grids have empty workgroups at their end.
        uint at = 3u * folded_workgroup();
        [[unroll]] for (uint c = 0u; c < 3u; ++c) {
            if (at + c < gain_parts.length()) gain_parts[at + c] = sum[c];
        }
    }
}

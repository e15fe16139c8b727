// Multiplies the colors of a rendered view by its learned factors, and by the vignetting of the lens.
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
INOUT(float, image); // [pixels * CHANNELS]: colors first

void main() {
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= params.step.camera.size.x * params.step.camera.size.y) return;
    vec3 gain = learned_vector(views[params.step.view], VIEW_GAIN);
    if (LENS) {
        gain += views[views.length() - 1u].values[LENS_VIGNETTING] * corner_share(params.step.camera.size, pixel);
    }
    gain = exp(gain);
    [[unroll]] for (uint c = 0u; c < 3u; ++c) image[pixel * CHANNELS + c] *= gain[c];
}

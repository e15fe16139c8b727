// Debt of each pixel before its first splat (see blend_bwd.glsl): the loss gradient that the splats still distribute.
//
// One number a pixel replaces the image in the backward pass. With STATISTIC only the losses that enter the densification
// statistic count.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint CHANNELS = 3;
layout(local_size_x_id = 0) in;
#include "statistic.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, image);
IN(float, transmittance);
IN(float, grad_image);
IN(float, grad_transmittance);
OUT(float, debt); // [pixels]

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    float sum = STATISTIC == STATISTIC_PHOTOMETRIC ? 0.0 : transmittance[pixel] * grad_transmittance[pixel];
    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) {
        if (STATISTIC == STATISTIC_TOTAL || in_statistic(c))
            sum += image[pixel * CHANNELS + c] * grad_image[pixel * CHANNELS + c];
    }
    debt[pixel] = sum;
}

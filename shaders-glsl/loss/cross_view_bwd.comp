// Adds the cross-view gradient of a region to the albedo gradient of its pixels.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "cross_view.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint view; // index of the view in `regions`
} push;

layout(scalar) uniform StepBlock { Step step; } params;

IN(uint, mask);
IN(CrossRegion, regions);
INOUT(vec3, albedo_gradient); // P, added to

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    uint word = mask[params.step.mask_offset + pixel / 32u];
    if ((word >> (pixel % 32u) & 1u) == 0u) return;
    albedo_gradient[pixel] += regions[push.view].pull;
}

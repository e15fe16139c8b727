// Copies one value per pixel to three equal channels, so that kernels which compare colors can compare it.
//
// Pixels without a surface become zero.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, values);
IN(float, coverage);
OUT(vec3, image);

void main() {
    uint p = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uvec2 size = params.step.camera.size;
    if (p >= size.x * size.y) return;
    image[p] = vec3(is_covered(coverage[p]) ? values[p] : 0.0);
}

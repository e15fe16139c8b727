// Backward of gray_image: adds the sum of the gradients of the three channels.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(vec3, image_gradient);
IN(float, coverage);
INOUT(float, gradient);

void main() {
    uint p = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uvec2 size = params.step.camera.size;
    if (p >= size.x * size.y || !is_covered(coverage[p])) return;
    vec3 g = image_gradient[p];
    gradient[p] += g.x + g.y + g.z;
}

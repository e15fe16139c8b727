// Depth of the visible surfaces in the form of a blended view: z times opacity, and transmittance. For passes that read
// blended views (carry_mask).
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(vec3, points);
IN(float, coverage);
OUT(vec2, image);         // z and nothing
OUT(float, transmittance);

void main() {
    uint p = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uvec2 size = params.step.camera.size;
    if (p >= size.x * size.y) return;
    float c = coverage[p];
    image[p] = vec2(to_camera(params.step.camera, points[p]).z * c, 0.0);
    transmittance[p] = 1.0 - c;
}

// Composites radiance over the background into an sRGB image clipped at white, and counts the clipped pixels.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool DIRECT = true;  // whether to add the radiance of trained lights
layout(constant_id = 3) const bool AMBIENT = true; // whether to add the radiance of the environment map

#define SUM_T float
#include "group_sum.glsl"

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec3, direct);    // P, linear
IN(vec3, ambient);   // P, linear
IN(float, coverage); // P
OUT(vec3, image);    // P, sRGB
OUT(float, sums);    // by workgroup: number of pixels with a channel clipped at white

#include "compose.glsl"

void main() {
    uvec2 size = params.step.camera.size;
    uint group = folded_workgroup();
    uint pixel = group * WORKGROUP + gl_LocalInvocationID.x;
    float saturated = 0.0;
    if (pixel < size.x * size.y) {
        vec3 light;
        vec3 linear = composed(pixel, coverage[pixel], light);
        image[pixel] = srgb_encode(linear);
        saturated = float(any(srgb_above(linear)));
    }
    float total = group_sum(saturated);
    if (gl_LocalInvocationID.x == 0u && group < sums.length()) sums[group] = total;
}

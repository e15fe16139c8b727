// Converts material images to the form of the priors: albedo in sRGB, roughness as gray.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"
#include "finite.glsl"
#include "srgb.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool ROUGHNESS = true; // whether to write roughness

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec4, materials);       // P: albedo (linear), roughness
IN(float, coverage);       // P
OUT(vec3, albedo_srgb);    // P
OUT(vec3, roughness_gray); // P, three equal channels

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    vec4 m = is_covered(coverage[pixel]) ? materials[pixel] : vec4(0.0);
    albedo_srgb[pixel] = srgb_encode(only_finite(m.rgb));
    if (ROUGHNESS) roughness_gray[pixel] = only_finite(vec3(m.w));
}

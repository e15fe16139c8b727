// Backward of the material images: gradients of the materials. One invocation per pixel.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"
#include "finite.glsl"
#include "srgb.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool ROUGHNESS = true; // whether there is a gradient of roughness

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec4, materials);           // P: albedo (linear), roughness
IN(float, coverage);           // P
IN(vec3, albedo_gradient);     // P
IN(vec3, roughness_gradient);  // P
INOUT(vec4, materials_gradient); // P, added to

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y || !is_covered(coverage[pixel])) return;
    vec4 m = materials[pixel];
    vec3 g = mix(vec3(0.0), srgb_slope(only_finite(m.rgb)) * albedo_gradient[pixel], finite3(m.rgb));
    g = mix(mix(g, vec3(0.0), srgb_above(m.rgb)), vec3(0.0), srgb_below(m.rgb));
    float by_roughness = 0.0;
    if (ROUGHNESS && finite_bits(m.w)) {
        vec3 r = roughness_gradient[pixel];
        by_roughness = r.x + r.y + r.z;
    }
    materials_gradient[pixel] += vec4(g, by_roughness);
}

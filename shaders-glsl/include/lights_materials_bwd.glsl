// Gradients of materials from the sums that shading left, without another loop over lights. Adds to the destination.
// Define METALLIC as 1 or 0.
#include "common.glsl"
#include "step.glsl"
#include "brdf.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec3, sums);
IN(float, coverage);
#if METALLIC
IN(vec4, materials);
IN(float, metallic);
#endif
IN(vec3, radiance_gradient);
INOUT(vec4, materials_gradient);
#if METALLIC
INOUT(float, metallic_gradient);
#endif

void main() {
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= params.step.camera.size.x * params.step.camera.size.y) return;
    if (!is_covered(coverage[pixel])) return;
    vec3 g = radiance_gradient[pixel];
    uint at = (METALLIC != 0 ? 4u : 2u) * pixel;
    vec3 lambert = g * sums[at] / PI;
    float by_roughness = dot(g, sums[at + 1u]);
#if METALLIC
    float m = metallic[pixel];
    vec3 albedo = materials[pixel].rgb;
    vec3 f0 = fresnel0(albedo, m);
    vec3 by_f0 = g * sums[at + 2u];
    if (25.0 * dot(f0, LUMINANCE) < 1.0) by_f0 += 25.0 * dot(g, sums[at + 3u]) * LUMINANCE;
    materials_gradient[pixel] += vec4((1.0 - m) * lambert + m * by_f0, by_roughness);
    metallic_gradient[pixel] += dot(by_f0, albedo - 0.04) - dot(lambert, albedo);
#else
    materials_gradient[pixel] += vec4(lambert, by_roughness);
#endif
}

// Radiance of each pixel under the environment map: (1 - M) A irradiance(n) + radiance(reflected, roughness) (F0 a + b).
// With DIFFUSE_ONLY the first term alone.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LEVELS = 5;
layout(constant_id = 2) const bool METALLIC = false;
layout(constant_id = 3) const bool DIFFUSE_ONLY = false;

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, points);    // [P * 3]
IN(float, normals);   // [P * 3] unit or zero
IN(float, coverage);  // [P]
IN(float, materials); // [P * 4] albedo, roughness
IN(float, metallic);  // [P]
IN(uvec2, levels);    // [LEVELS] size, first texel
IN(float, radiance);  // all levels
IN(vec2, split_sum);
OUT(float, ambient);  // [P * 3]

#include "environment.glsl"

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= params.step.camera.size.x * params.step.camera.size.y) return;
    vec3 normal = vec3(normals[3u * i], normals[3u * i + 1u], normals[3u * i + 2u]);
    vec3 result = vec3(0.0);
    if (coverage[i] >= ENVIRONMENT_COVERAGE_MIN && dot(normal, normal) > 0.0) {
        vec3 albedo = vec3(materials[4u * i], materials[4u * i + 1u], materials[4u * i + 2u]);
        float metal = METALLIC ? metallic[i] : 0.0;
        vec3 view = params.step.camera.position - vec3(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]);
        view *= inversesqrt(max(dot(view, view), 1e-30));
        Seen s = environment_seen(normal, view, materials[4u * i + 3u]);
        vec3 f0 = mix(vec3(0.04), albedo, metal);
        result = (1.0 - metal) * albedo * s.irradiance;
        if (!DIFFUSE_ONLY) result += s.reflected * (f0 * s.split.x + s.split.y);
    }
    ambient[3u * i] = result.x;
    ambient[3u * i + 1u] = result.y;
    ambient[3u * i + 2u] = result.z;
}

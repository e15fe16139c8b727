// Radiance under all lights with each exact optimization separately, for `engine-bench savings` only.
//
// One pixel a lane, one light after the other; specialization constants select the optimization.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;
layout(constant_id = 2) const bool IRRADIANCE = false; // light is summed, and multiplied by the Lambert term once
layout(constant_id = 3) const bool FRESNEL = false;    // two gray sums in place of a color for each light
layout(constant_id = 4) const bool FACING = false;     // lights that all pixels of a subgroup face away from are skipped

#include "brdf.glsl"
#include "lights.glsl"

layout(push_constant, scalar) uniform Push {
    float normalizer;
    uint lights;
} push;

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec4, prepared);
IN(vec3, points);
IN(vec3, normals);
IN(vec4, materials); // albedo, roughness
OUT(vec3, direct);

void main() {
    uvec2 size = params.step.camera.size;
    uint pixels = size.x * size.y;
    uint mine = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uint pixel = min(mine, pixels - 1u);
    vec4 m = materials[pixel];
    Surface s = surface(points[pixel], normals[pixel], m.w, params.step.camera.position);
    vec3 f0 = fresnel0(m.rgb, 0.5);
    float f90 = fresnel90(f0);
    vec3 irradiance = vec3(0.0), plain = vec3(0.0), grazing = vec3(0.0), sum = vec3(0.0);
    uint count = by_workgroup(push.lights);
    for (uint light = 0u; light < count; light++) {
        Ray ray = ray_to(prepared[light_at(light)].xyz, s.point);
        float nl = max(dot(s.normal, ray.l), 0.0);
        // Loops are the only branches that software devices take.
        uint lobes = !FACING || subgroupAny(nl > 0.0) ? LOBES : 0u;
        vec3 emitted = vec3(0.0);
        [[dont_unroll]] for (uint k = 0u; k < lobes; k++) {
            uint at = light_at(light) + 1u + 2u * k;
            vec4 axis = prepared[at];
            vec3 u = axis.w * ray.l - axis.xyz;
            emitted += exp2(-dot(u, u)) * prepared[at + 1u].rgb;
        }
        [[dont_unroll]] for (uint once = 0u; once < min(lobes, 1u); once++) {
            vec3 e = nl * falloff(ray) * emitted;
            Lit r = lit_by(s, ray.l, nl);
            if (IRRADIANCE) irradiance += e;
            else sum += 0.5 / PI * m.rgb * e;
            if (FRESNEL) {
                float shiny = r.specular;
                plain += shiny * (1.0 - r.fresnel) * e;
                grazing += shiny * r.fresnel * e;
            } else {
                sum += r.specular * mix(f0, vec3(f90), r.fresnel) * e;
            }
        }
    }
    sum += 0.5 / PI * m.rgb * irradiance + f0 * plain + f90 * grazing;
    if (mine < pixels) direct[pixel] = push.normalizer * sum;
}

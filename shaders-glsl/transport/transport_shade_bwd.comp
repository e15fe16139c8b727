// Gradients of materials, gathered irradiance, gain, emission and light colors from those of pixels' radiance.
//
// A workgroup, which is one subgroup, takes a range of blocks of pixels, a pixel a lane, and sums the gradients of the lights'
// colors over them in a row of its own. Rows are summed afterwards, in order (lights_reduce).
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;

#include "transport_shade.glsl"

layout(push_constant, scalar) uniform Push {
    uint lights;
    uint stride;     // pixels from one light's numbers to the next one's
    uint blocks;     // of a workgroup
    uint workgroups;
} push;

IN(vec3, radiance_gradient);
INOUT(vec4, materials_gradient);   // added to
INOUT(float, metallic_gradient);   // added to, with METALLIC
OUT(vec4, irradiance_gradient);    // and the gain's
OUT(vec4, emission_gradient);      // with EMISSION
INOUT(float, partials);            // [workgroups * lights * 3], zeros to begin with

void main() {
    if (folded_workgroup() >= push.workgroups) return;
    uint row = folded_workgroup() * push.lights * 3u, lane = gl_SubgroupInvocationID;
    for (uint block = 0u; block < by_workgroup(push.blocks); block++) {
        uint i = (folded_workgroup() * push.blocks + block) * SUBGROUP + lane;
        bool here = shaded(i);
        Pixel p = load_pixel(here ? i : 0u);
        vec3 by_radiance = here ? radiance_gradient[i] : vec3(0.0);
        vec3 g = here ? p.gain * by_radiance : vec3(0.0);
        vec3 sum = vec3(0.0), plain = vec3(0.0), grazing = vec3(0.0), by_roughness = vec3(0.0);
        for (uint light = 0u; light < by_workgroup(push.lights); light++) {
            vec3 by_color = vec3(0.0);
            float reaching = here ? unit[light * push.stride + i] : 0.0;
            if (reaching > 0.0) {
                vec3 e = reaching * light_colors[light];
                Highlight h = highlight(p.surface, representative(light_records[light], p));
                vec3 glossy = h.specular * fresnel_of(p, h.fresnel);
                sum += e;
                plain += h.specular * (1.0 - h.fresnel) * e;
                grazing += h.specular * h.fresnel * e;
                by_roughness += h.by_roughness * glossy * e;
                by_color = reaching * g * ((1.0 - p.metallic) / PI * p.albedo + glossy);
            }
            by_color = vec3(subgroupAdd(by_color.r), subgroupAdd(by_color.g), subgroupAdd(by_color.b));
            if (lane < 3u) {
                partials[row + 3u * light + lane] += lane == 0u ? by_color.r : lane == 1u ? by_color.g : by_color.b;
            }
        }
        if (here) {
            vec3 gathered = g * p.gathered;
            vec3 matte = g * sum / PI + gathered;
            float roughness = dot(g, by_roughness) +
                              dot(gathered, p.f0 * p.split_by_roughness.x + p.f90 * p.split_by_roughness.y);
            vec4 by_material = vec4((1.0 - p.metallic) * matte, roughness);
            if (METALLIC) {
                vec3 by_f0 = g * plain + gathered * p.split.x;
                if (25.0 * dot(p.f0, LUMINANCE) < 1.0) {
                    float by_f90 = dot(g, grazing) + (gathered.r + gathered.g + gathered.b) * p.split.y;
                    by_f0 += 25.0 * by_f90 * LUMINANCE;
                }
                by_material.rgb += p.metallic * by_f0;
                metallic_gradient[i] += dot(by_f0, p.albedo - 0.04) - dot(matte, p.albedo);
            }
            materials_gradient[i] += by_material;
            vec3 reflected = (1.0 - p.metallic) / PI * p.albedo * sum + p.f0 * plain + p.f90 * grazing +
                             hemispherical(p) * p.gathered;
            irradiance_gradient[i] = vec4(g * hemispherical(p) / PI, dot(by_radiance, reflected));
            if (EMISSION) emission_gradient[i] = vec4(by_radiance, 0.0);
        } else if (i < params.step.camera.size.x * params.step.camera.size.y) {
            irradiance_gradient[i] = vec4(0.0);
            if (EMISSION) emission_gradient[i] = vec4(0.0);
        }
    }
}

// Radiance of pixels: physical lights with shadows, gathered irradiance, reflections, emission. With TERMS also each term.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 3) const bool TERMS = false;

#include "transport_shade.glsl"

layout(push_constant, scalar) uniform Push {
    uint lights;
    uint stride; // pixels from one light's numbers to the next one's
} push;

IN(vec4, emission); // radiance, rgb
OUT(vec3, radiance);
OUT(vec3, diffuse);
OUT(vec3, specular);
OUT(vec3, indirect);
OUT(vec3, emitted);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= params.step.camera.size.x * params.step.camera.size.y) return;
    vec3 matte = vec3(0.0), glossy = vec3(0.0), bounced = vec3(0.0), own = vec3(0.0);
    if (shaded(i)) {
        Pixel p = load_pixel(i);
        vec3 sum = vec3(0.0), plain = vec3(0.0), grazing = vec3(0.0);
        for (uint light = 0u; light < by_workgroup(push.lights); light++) {
            float reaching = unit[light * push.stride + i];
            vec3 color = light_colors[light];
            if (reaching > 0.0 && color != vec3(0.0)) {
                vec3 e = reaching * color;
                Highlight h = highlight(p.surface, representative(light_records[light], p));
                sum += e;
                plain += h.specular * (1.0 - h.fresnel) * e;
                grazing += h.specular * h.fresnel * e;
            }
        }
        matte = p.gain * (1.0 - p.metallic) / PI * p.albedo * sum;
        glossy = p.gain * (p.f0 * plain + p.f90 * grazing);
        bounced = p.gain * hemispherical(p) * p.gathered;
        if (REFLECTIONS) {
            vec3 met = irradiance[push.stride + i].rgb;
            bounced = p.gain * ((1.0 - p.metallic) * p.albedo * p.gathered + lobe_albedo(p) * met);
        }
        if (EMISSION) own = emission[i].rgb;
    }
    radiance[i] = matte + glossy + bounced + own;
    if (TERMS) {
        diffuse[i] = matte;
        specular[i] = glossy;
        indirect[i] = bounced;
        emitted[i] = own;
    }
}

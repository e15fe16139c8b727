// Pairs of visibility_bwd.glsl and visibility_bwd_lanes.glsl under prepared lights.
//
// A pair contributes visibility times the light's unshadowed radiance at the pixel times the gradient of that radiance.
#include "common.glsl"
#include "finite.glsl"
#include "random.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_grid.glsl"
#include "visibility_jitter.glsl"
#define FIELD_PIXELS
#include "visibility_bwd_interface.glsl"

IN(vec3, radiance_gradient);

// A pixel's material times the gradient of its radiance.
vec3 pixel_gradient, matte, reflectance;
float edge_on;

uint light_count() { return light_list[0]; }

uint light_of(uint i) { return light_list[1u + i]; }

vec3 light_place(uint light) { return prepared[light_at(light)].xyz; }

void pair_begin(uint pixel, bool is_shaded) {
    surfaces[0] = load_surface(pixel, is_shaded);
    pixel_gradient = matte = vec3(0.0);
    reflectance = vec3(0.04);
    edge_on = 1.0;
    if (is_shaded) {
        pixel_gradient = push.normalizer * radiance_gradient[pixel];
        vec3 albedo = materials[pixel].rgb;
        float metal = 0.0;
        if (METALLIC) {
            metal = metallic[pixel];
            reflectance = fresnel0(albedo, metal);
            edge_on = fresnel90(reflectance);
        }
        matte = (1.0 - metal) / PI * albedo * pixel_gradient;
    }
}

bool pair_matters(uint light) { return dot(surfaces[0].normal, light_place(light) - surfaces[0].point) > 0.0; }

float pair_gradient(uint light) {
    Ray ray = ray_to(light_place(light), surfaces[0].point);
    float nl = max(dot(surfaces[0].normal, ray.l), 0.0);
    vec3 emitted = vec3(0.0);
    [[dont_unroll]] for (uint k = 0u; k < LOBES; k++) {
        Lobe lobe = load_lobe(light, k);
        vec3 u = lobe.axis.w * ray.l - lobe.axis.xyz;
        emitted += exp2(-dot(u, u)) * lobe.amplitude;
    }
    Lit r = lit_by(surfaces[0], ray.l, nl);
    vec3 glossy = r.specular * mix(reflectance, vec3(edge_on), r.fresnel) * pixel_gradient;
    return nl * falloff(ray) * dot(matte + glossy, emitted);
}

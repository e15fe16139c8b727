// A pixel under physical lights and gathered irradiance, for shading and its gradients.
//
// Highlights of lights with an extent: the representative point of Karis (2013), the point of the light closest to the
// mirrored ray, and a wider lobe. The lobe widens so that a mirror at normal incidence reflects the light's own radiance.

#include "step.glsl"
#include "brdf.glsl"
#include "coverage.glsl"
#include "area_light.glsl"

layout(constant_id = 1) const bool METALLIC = false; // without it metallic is 0 everywhere
layout(constant_id = 2) const bool EMISSION = false;
layout(constant_id = 4) const bool REFLECTIONS = false; // whether a traced radiance reaches the specular lobe

layout(scalar) uniform StepBlock { Step step; } params;
IN(vec3, points);
IN(vec3, normals);        // unit or zero
IN(float, coverage);
IN(vec4, materials);      // linear albedo, roughness
IN(float, metallic);
IN(vec4, irradiance);     // gathered, rgb; gain of all light that arrives. With REFLECTIONS then the radiance of the lobe
IN(LightRecord, light_records);
IN(vec3, light_colors);
IN(float, unit);          // [lights * stride]
IN(vec2, split_sum);

#include "split_sum.glsl"

// Smallest n.v of mirrored rays. Below it the half vector of a mirrored ray and the view would be rounding.
const float MIRRORED_MIN = 0.01;

// Smallest |l + v|^2 of highlights. Light from opposite the view has no half vector.
const float HALF_MIN = 1e-6;

// What does not depend on the light.
struct Pixel {
    Surface surface;
    vec3 mirrored; // direction
    vec3 albedo;
    float metallic;
    vec3 f0;
    float f90;
    vec2 split;    // factors of f0 and of f90 in the lobe's hemispherical albedo
    vec2 split_by_roughness;
    vec3 gathered; // irradiance over pi
    float gain;    // factor on all reflected light
};

// Whether a pixel exists and has a surface with a normal.
bool shaded(uint pixel) {
    if (pixel >= params.step.camera.size.x * params.step.camera.size.y) return false;
    return is_covered(coverage[pixel]) && normals[pixel] != vec3(0.0);
}

Pixel load_pixel(uint i) {
    Pixel p;
    p.surface = surface(points[i], normals[i], materials[i].w, params.step.camera.position);
    p.mirrored = normalize(2.0 * max(p.surface.facing, MIRRORED_MIN) * p.surface.normal - p.surface.view);
    p.albedo = materials[i].rgb;
    p.metallic = METALLIC ? metallic[i] : 0.0;
    p.f0 = vec3(0.04);
    p.f90 = 1.0;
    if (METALLIC) {
        p.f0 = fresnel0(p.albedo, p.metallic);
        p.f90 = fresnel90(p.f0);
    }
    p.split = split_sum_at(p.surface.roughness, clamp(p.surface.facing, SPLIT_SUM_NV_MIN, 1.0), p.split_by_roughness);
    p.gathered = irradiance[i].rgb / PI;
    p.gain = irradiance[i].w;
    return p;
}

// The direction that stands for a light, and what the light's extent adds to alpha along two axes.
struct Representative {
    vec3 direction;
    vec2 spread;
};

const float SPREAD_MAX = 0.5;

Representative representative(LightRecord light, Pixel p) {
    vec3 r = p.mirrored;
    if (light.kind == LIGHT_DIRECTIONAL) {
        float s = light.radius, c = sqrt((1.0 - s) * (1.0 + s)), facing = dot(light.origin, r);
        vec3 apart = r - facing * light.origin;
        bool inside = facing >= c && s > 0.0;
        vec3 edge = c * light.origin + s * inversesqrt(max(dot(apart, apart), 1e-30)) * apart;
        return Representative(inside ? r : normalize(edge), vec2(0.5 * s));
    }
    vec3 to = light.origin - p.surface.point;
    if (light_is_point(light.kind)) {
        return Representative(to * inversesqrt(max(dot(to, to), 1e-30)), vec2(0.0));
    }
    if (light.kind == LIGHT_SPHERE) {
        float square = dot(to, to), s = light.radius * inversesqrt(max(square, 1e-30));
        vec3 apart = max(dot(to, r), 0.0) * r - to;
        vec3 closest = to + min(light.radius * inversesqrt(max(dot(apart, apart), 1e-30)), 1.0) * apart;
        return Representative(s < 1.0 ? normalize(closest) : r, vec2(min(0.5 * s, SPREAD_MAX)));
    }
    // Where the mirrored ray meets the plane; a ray that does not meet it is bent towards it.
    vec3 hit = dot(light.normal, to) / min(dot(light.normal, r), -1e-6) * r - to;
    vec3 center = to;
    vec2 spread;
    if (light.kind != LIGHT_DISK) {
        vec2 square = vec2(dot(light.axis, light.axis), dot(light.side, light.side));
        vec2 at = clamp(vec2(dot(hit, light.axis), dot(hit, light.side)) / square, 0.0, 1.0);
        center += 0.5 * (light.axis + light.side);
        to += at.x * light.axis + at.y * light.side;
        // A disk of the same area as a square of this side.
        spread = 0.282094792 * sqrt(square);
    } else {
        hit -= dot(light.normal, hit) * light.normal;
        to += min(light.radius * inversesqrt(max(dot(hit, hit), 1e-30)), 1.0) * hit;
        spread = vec2(0.5 * light.radius);
    }
    // Foreshortened.
    float square = max(dot(center, center), 1e-30), inverse = inversesqrt(square);
    spread *= inverse * sqrt(max(-dot(light.normal, center) * inverse, 0.0));
    return Representative(to * inversesqrt(max(dot(to, to), 1e-30)), min(spread, vec2(SPREAD_MAX)));
}

// Specular term of a light, without Fresnel's factor, per irradiance; 0 where the representative point is below the horizon.
struct Highlight {
    float specular;
    float fresnel;      // (1 - l.h)^5
    float by_roughness; // derivative of ln(specular)
};

Highlight highlight(Surface s, Representative light) {
    float nl = dot(s.normal, light.direction);
    vec3 twice_half = light.direction + s.view;
    if (nl <= 0.0 || dot(twice_half, twice_half) < HALF_MIN) return Highlight(0.0, 0.0, 0.0);
    Lit lit = lit_by(s, light.direction, nl);
    float alpha = max(s.roughness * s.roughness, ALPHA_MIN);
    vec2 wide = min(alpha + light.spread, vec2(1.0));
    vec2 share = vec2(lessThan(alpha + light.spread, vec2(1.0))) * alpha / wide;
        // d ln(alpha^2 / (wide.x wide.y)) / d ln(alpha^2).
    float narrowing = 1.0 - 0.5 * (share.x + share.y);
    Highlight h;
    h.specular = lit.specular * alpha * alpha / (wide.x * wide.y);
    h.fresnel = lit.fresnel;
    h.by_roughness = alpha_by_roughness(s) * (by_alpha(s, lit) + narrowing);
    return h;
}

vec3 fresnel_of(Pixel p, float c) { return METALLIC ? mix(p.f0, vec3(p.f90), c) : vec3(0.04 + 0.96 * c); }

// Hemispherical albedo of the specular lobe: k_s.
vec3 lobe_albedo(Pixel p) { return p.f0 * p.split.x + p.f90 * p.split.y; }

// Hemispherical albedo: k_d + k_s.
vec3 hemispherical(Pixel p) { return (1.0 - p.metallic) * p.albedo + p.f0 * p.split.x + p.f90 * p.split.y; }

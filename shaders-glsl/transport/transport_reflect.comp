// Radiance that reaches each pixel's specular lobe from surfels and patches: rays about the mirrored view. An invocation per
// pixel.
//
// Half vectors are visible normals of GGX (Heitz 2018; by spherical caps, Dupuy and Benyoub 2023) at a Hammersley set, which
// a hash of the pixel turns. It does not shift them outwards: rays of the lobe's tail would show small bright surfaces as
// bright pixels. A ray counts by G2 / G1, so that a ray behind the surface does not count. Where it meets discs, their
// radiance is interpolated: a disc's weight falls to 0 at its edge and at the end of the window behind the first disc.
// Between the centers of patches it is bilinear.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"
#include "random.glsl"
#include "brdf.glsl"
#include "enclosure.glsl"
#define SURFEL_VALUES
#include "surfels.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint RAYS = 8; // of a pixel that is no mirror

layout(push_constant, scalar) uniform Push {
    EnclosureBox enclosure;
    uint surfels;  // the first ones of the receivers
    uint pixels;   // from the irradiance to the reflected radiance
    uint seed;
    float offset;  // of rays' begin along the normal
    float window;  // depth behind the first disc in which discs count
    float mirror;  // roughness below which a pixel has one ray
    float fade;    // roughness from which reflections fade
    float diffuse; // roughness from which there are none
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(vec3, points);
IN(vec3, normals);       // unit or zero
IN(float, coverage);
IN(vec4, materials);     // linear albedo, roughness
IN(vec3, radiosity);     // [receivers]: as a radiance
INOUT(vec4, irradiance); // [pixels] gathered, gain; then [pixels] reflected radiance, number of rays

// Smallest n.v of a pixel's rays.
const float FACING_MIN = 0.01;
// Smallest weight of a disc, at its edge.
const float EDGE_MIN = 1e-6;

// Distance of the ray's first disc.
float first_met;

vec4 surfel_value(SurfelDisc disc, float at, float beside) {
    float weight = max(1.0 - beside, EDGE_MIN) * max(1.0 - (at - first_met) / push.window, EDGE_MIN);
    return weight * vec4(radiosity[disc.index], 1.0);
}

vec3 patch_radiance(vec3 from, vec3 along) {
    EnclosureExit e = enclosure_leave(push.enclosure, from, along);
    vec2 last = vec2(e.cells - 1u);
    vec2 place = clamp(e.place - 0.5, vec2(0.0), last), low = floor(place), t = place - low;
    uvec2 a = uvec2(low), b = uvec2(min(low + 1.0, last));
    uint row_a = push.surfels + e.first + e.cells.x * a.y, row_b = push.surfels + e.first + e.cells.x * b.y;
    return mix(mix(radiosity[row_a + a.x], radiosity[row_a + b.x], t.x),
               mix(radiosity[row_b + a.x], radiosity[row_b + b.x], t.x), t.y);
}

vec3 radiance_along(vec3 from, vec3 along) {
    uint met = surfel_first(from, along, first_met);
    if (met == SURFEL_NONE) return patch_radiance(from, along);
    // Rounding may not lose the first disc.
    vec4 sum = surfel_sum(from, along, 0.999 * first_met, first_met + push.window);
    return sum.w > 0.0 ? sum.rgb / sum.w : radiosity[met];
}

// A visible normal around z, of a view above the surface.
vec3 visible_normal(vec3 view, float alpha, vec2 x) {
    vec3 stretched = normalize(vec3(alpha * view.xy, view.z));
    float z = (1.0 - x.x) * (1.0 + stretched.z) - stretched.z;
    float sine = sqrt(clamp((1.0 - z) * (1.0 + z), 0.0, 1.0)), turn = 2.0 * PI * x.y;
    vec3 h = vec3(sine * cos(turn), sine * sin(turn), z) + stretched;
    return normalize(vec3(alpha * h.xy, max(h.z, 0.0)));
}

// Mean radiance of the lobe's rays, and their number; no radiance if all are behind the surface.
vec4 reflected_radiance(uint pixel, vec3 point, vec3 normal, float roughness) {
    vec3 to_camera = params.step.camera.position - point;
    vec3 view = to_camera * inversesqrt(max(dot(to_camera, to_camera), 1e-30));
    float facing = dot(normal, view);
    view = normalize(view + (max(facing, FACING_MIN) - facing) * normal);
    // Orthonormal basis (Duff et al. 2017).
    float side = normal.z >= 0.0 ? 1.0 : -1.0;
    float c = -1.0 / (side + normal.z), d = normal.x * normal.y * c;
    vec3 tangent = vec3(1.0 + side * normal.x * normal.x * c, side * d, -side * normal.x);
    vec3 bitangent = vec3(d, side + normal.y * normal.y * c, -normal.y);
    vec3 local = vec3(dot(view, tangent), dot(view, bitangent), dot(view, normal));
    bool mirror = roughness < push.mirror;
    float alpha = max(roughness * roughness, ALPHA_MIN), a = alpha * alpha;
    float root_v = sqrt(a + local.z * local.z * (1.0 - a));
    // In units of 2^-32, so that it wraps at 1.
    uint shift = random_bits(push.seed, pixel, 0u), rays = mirror ? 1u : RAYS;
    vec4 sum = vec4(0.0);
    [[dont_unroll]] for (uint s = 0u; s < rays; s++) {
        vec2 x = vec2((float(s) + 0.5) / float(RAYS), uniform_from(shift + bitfieldReverse(s)));
        vec3 h = mirror ? vec3(0.0, 0.0, 1.0) : visible_normal(local, alpha, x);
        vec3 l = 2.0 * dot(local, h) * h - local;
        if (l.z <= 0.0) continue;
        float root_l = sqrt(a + l.z * l.z * (1.0 - a));
        float weight = l.z * (local.z + root_v) / (l.z * root_v + local.z * root_l);
        vec3 along = normalize(l.x * tangent + l.y * bitangent + l.z * normal);
        sum += weight * vec4(radiance_along(point + push.offset * normal, along), 1.0);
    }
    return vec4(sum.rgb / sum.w, sum.w > 0.0 ? float(rays) : 0.0);
}

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= params.step.camera.size.x * params.step.camera.size.y) return;
    vec4 reflected = vec4(0.0);
    vec3 point = points[i], normal = normals[i];
    if (is_covered(coverage[i]) && normal != vec3(0.0)) {
        reflected.rgb = irradiance[i].rgb / PI;
        float roughness = materials[i].w;
        // False where a value is not finite.
        if (roughness < push.diffuse && dot(point, point) < 1e36 && dot(normal, normal) < 2.0) {
            vec4 mean = reflected_radiance(i, point, normal, roughness);
            float share = clamp((push.diffuse - roughness) / (push.diffuse - push.fade), 0.0, 1.0);
            if (mean.w > 0.0) reflected = vec4(mix(reflected.rgb, mean.rgb, share), mean.w);
        }
    }
    irradiance[push.pixels + i] = reflected;
}

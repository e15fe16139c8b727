// Irradiance of receivers from physical lights of color 1, with shadows. Define PIXELS as 1 (a view) or 0 (surfels and
// patches).
//
// An invocation takes a receiver and a light. The unoccluded irradiance is exact; shadow rays to SAMPLES points estimate the
// visible share of it, so that receivers without occluders have no noise. A receiver in the dark traces no ray.
//
// Directional light arrives only along rays that leave the room through an opening. The radiance of a window depends on
// direction: its samples carry that of the sky.
#include "common.glsl"
#if PIXELS
#include "step.glsl"
#include "coverage.glsl"
#endif
#include "random.glsl"
#include "area_light.glsl"
#include "light_irradiance.glsl"
#include "light_samples.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint SAMPLES = 16; // of a light with an extent; a power of two
layout(constant_id = 2) const bool LISTED = false; // whether only the lights of `light_list` are updated

#include "surfels.glsl"

layout(push_constant, scalar) uniform Push {
    uint groups;     // workgroups of a light
    uint lights;
    uint receivers;  // from one light's numbers to the next one's
    uint seed;
    float offset;    // of rays' begin above the surface
    float clearance; // of their end before the light or the opening
    uint openings;
    uint sky_columns;
    uint sky_rows;
} push;

#include "outside.glsl"

#if PIXELS
layout(scalar) uniform StepBlock { Step step; } params;
IN(vec3, points);
IN(vec3, normals);   // unit or zero
IN(float, coverage);
#else
IN(vec4, receivers); // [receivers * 2] point, radius; unit normal, 0
#endif
IN(LightRecord, light_records);
IN(uint, light_list); // how many are updated, and which
OUT(float, unit);     // [lights * receivers]

// Whether a ray to a point of a light meets a surfel, or leaves the room elsewhere than through an opening.
bool occluded(LightRecord light, vec3 point, vec3 normal, vec3 to) {
    vec3 d = to - push.offset * normal, start = point + push.offset * normal;
    float square = dot(d, d), inverse = inversesqrt(max(square, 1e-30));
    float reach = square * inverse;
    if (light.kind == LIGHT_DIRECTIONAL) {
        reach = opening_distance(start, inverse * d);
        if (reach < 0.0) return true;
    }
    reach -= push.clearance;
    return reach > 0.0 && surfel_hidden(start, inverse * d, reach);
}

// Radiance of a light of color 1 along a ray to it.
float arriving(LightRecord light, vec3 to) {
    return light.kind == LIGHT_WINDOW ? sky_radiance(to, uint(light.bias)) : 1.0;
}

void main() {
    uint group = folded_workgroup(), light = group / push.groups;
    uint i = group % push.groups * WORKGROUP + gl_LocalInvocationID.x;
    if (light >= push.lights || i >= push.receivers) return;
    if (LISTED) {
        if (light >= light_list[0]) return;
        light = light_list[1u + light];
    }
#if PIXELS
    bool here = i < params.step.camera.size.x * params.step.camera.size.y;
    if (!here) return;
    vec3 point = points[i], normal = normals[i];
    here = is_covered(coverage[i]);
#else
    vec3 point = receivers[2u * i].xyz, normal = receivers[2u * i + 1u].xyz;
    bool here = true;
#endif
    LightRecord record = light_records[light];
    float exact = 0.0;
    // False where a value is not finite.
    here = here && dot(normal, normal) > 0.0 && dot(point, point) < 1e36;
    if (here) exact = light_irradiance(record, point, normal);
    float result = 0.0;
    if (exact > 0.0) {
        bool extent = !light_is_point(record.kind) &&
                      !(record.kind == LIGHT_DIRECTIONAL && record.radius == 0.0);
        float all = 0.0, seen = 0.0;
        if (extent) {
            // The channels of a window have the same points.
            vec2 shift = light_shift(push.seed, i, record.kind == LIGHT_WINDOW ? LIGHT_WINDOW_POINTS : light);
            [[dont_unroll]] for (uint s = 0u; s < SAMPLES; s++) {
                LightSample l = light_sample(record, point, normal, light_point(s, SAMPLES, shift));
                all += l.weight;
                if (l.weight > 0.0 && !occluded(record, point, normal, l.to)) seen += l.weight * arriving(record, l.to);
            }
        }
        if (all > 0.0) {
            result = exact * (seen / all);
        } else {
            vec3 to = extent ? light_top(record, point, normal)
                             : record.kind == LIGHT_DIRECTIONAL ? LIGHT_FAR * record.origin : record.origin - point;
            result = occluded(record, point, normal, to) ? 0.0 : exact * arriving(record, to);
        }
    }
    unit[light * push.receivers + i] = result;
}

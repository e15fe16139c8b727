// Light of a pixel from a prefiltered environment map. Needs a constant LEVELS, and the buffers `levels`, `radiance` and
// `split_sum`.

#include "cube.glsl"
#include "split_sum.glsl"

// Pixels with less blended opacity are not shaded.
const float ENVIRONMENT_COVERAGE_MIN = 1e-3;

// Where a roughness lies among the levels: 0.08 to 0.5 in even steps, then 1. `slope` is the derivative.
float environment_level(float roughness, out float slope) {
    float last = float(LEVELS) - 2.0;
    bool low = roughness < 0.5;
    float steps = last / 0.42;
    slope = low ? (roughness > 0.08 ? steps : 0.0) : (roughness < 1.0 ? 2.0 : 0.0);
    return low ? (max(roughness, 0.08) - 0.08) * steps : 2.0 * (min(roughness, 1.0) - 0.5) + last;
}

vec3 environment_texel(uint at) { return vec3(radiance[3u * at], radiance[3u * at + 1u], radiance[3u * at + 2u]); }

vec3 environment_lookup(vec3 d, uvec2 level) {
    Footprint f = cube_footprint(d, level.x);
    vec3 sum = vec3(0.0);
    [[dont_unroll]] for (uint c = 0u; c < 4u; c++) {
        float w;
        uint texel = corner(f, c, w);
        sum += w * environment_texel(level.y + texel);
    }
    return sum;
}

struct Seen {
    vec3 irradiance; // over pi: radiance of a white diffuse surface
    vec3 reflected;  // through the lobe of this roughness
    vec3 by_level;   // derivative of that by the level
    float slope;     // of the level by roughness
    vec2 split;      // factor of F0, and the bias
    vec2 by_roughness;
    vec3 mirrored;   // direction
    uvec2 sharper, blurrier; // size and first texel of the two levels
    float part;      // of the blurrier one
};

Seen environment_seen(vec3 normal, vec3 view, float roughness) {
    Seen s;
    float facing = dot(normal, view);
    s.mirrored = 2.0 * max(facing, 0.0) * normal - view;
    s.split = split_sum_at(roughness, clamp(facing, SPLIT_SUM_NV_MIN, 1.0), s.by_roughness);
    float level = environment_level(roughness, s.slope);
    uint first = min(uint(level), LEVELS - 2u);
    s.part = level - float(first);
    s.sharper = levels[first];
    s.blurrier = levels[first + 1u];
    vec3 a = environment_lookup(s.mirrored, s.sharper), b = environment_lookup(s.mirrored, s.blurrier);
    s.by_level = b - a;
    s.reflected = a + s.part * s.by_level;
    s.irradiance = environment_lookup(normal, levels[LEVELS - 1u]);
    return s;
}

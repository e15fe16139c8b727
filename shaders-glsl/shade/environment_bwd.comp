// Backward of environment: adds gradients of materials; sums those of the filtered texels in fixed point, so that their
// order does not matter. Normals are detached.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "finite.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LEVELS = 5;
layout(constant_id = 2) const bool METALLIC = false;
layout(constant_id = 3) const int FIXED_BITS = 30;
layout(constant_id = 4) const bool MERGE = false; // whether lanes that meet in a texel add up first

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, points);
IN(float, normals);
IN(float, coverage);
IN(float, materials);
IN(float, metallic);
IN(uvec2, levels);
IN(float, radiance);
IN(vec2, split_sum);
IN(float, radiance_gradient);      // [P * 3]
IN(uint, largest);                 // [1] bits of the bound
INOUT(float, materials_gradient);  // [P * 4] added to
INOUT(float, metallic_gradient);   // [P] added to
INOUT(uint, texel_sums);           // [texels * 3 * 2] low and high words

#include "environment.glsl"
#include "environment_bound.glsl"
#include "fixed.glsl"

void add(uint at, float units, bool together) {
    uvec2 v = to_fixed(units);
    if (together) {
        // Halves of the low word, so that no carry is lost: sums of integers are the same in any order.
        uvec3 s = subgroupAdd(uvec3(v.x & 0xffffu, v.x >> 16u, v.y));
        uint upper = s.y + (s.x >> 16u);
        v = uvec2(upper << 16u | s.x & 0xffffu, s.z + (upper >> 16u));
        if (!subgroupElect()) return;
    }
    if ((v.x | v.y) == 0u) return;
    uint before = atomicAdd(texel_sums[2u * at], v.x);
    // The low word carries on overflow. No kernel reads in between, so the final sum is exact.
    v.y += before + v.x < v.x ? 1u : 0u;
    if (v.y != 0u) atomicAdd(texel_sums[2u * at + 1u], v.y);
}

void spread(Footprint f, uint c, uint first, vec3 units) {
    float w;
    uint at = 3u * (first + corner(f, c, w));
    if (w == 0.0) return;
    // Pixels of a wall share texels of the coarse levels, and atomics to one word wait for each other.
    bool together = MERGE && subgroupAllEqual(at);
    add(at, w * units.x, together);
    add(at + 1u, w * units.y, together);
    add(at + 2u, w * units.z, together);
}

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= params.step.camera.size.x * params.step.camera.size.y) return;
    vec3 normal = vec3(normals[3u * i], normals[3u * i + 1u], normals[3u * i + 2u]);
    if (!(coverage[i] >= ENVIRONMENT_COVERAGE_MIN && dot(normal, normal) > 0.0)) return;
    vec3 g = vec3(radiance_gradient[3u * i], radiance_gradient[3u * i + 1u], radiance_gradient[3u * i + 2u]);
    vec3 albedo = vec3(materials[4u * i], materials[4u * i + 1u], materials[4u * i + 2u]);
    float roughness = materials[4u * i + 3u], metal = METALLIC ? metallic[i] : 0.0;
    vec3 view = params.step.camera.position - vec3(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]);
    view *= inversesqrt(max(dot(view, view), 1e-30));
    Seen s = environment_seen(normal, view, roughness);
    vec3 f0 = mix(vec3(0.04), albedo, metal);
    vec3 factor = f0 * s.split.x + s.split.y;

    vec3 by_diffuse = g * s.irradiance, by_f0 = g * s.reflected * s.split.x;
    vec3 by_albedo = (1.0 - metal) * by_diffuse + metal * by_f0;
    float by_roughness = dot(g, s.slope * s.by_level * factor + s.reflected * (f0 * s.by_roughness.x + s.by_roughness.y));
    materials_gradient[4u * i] += by_albedo.x;
    materials_gradient[4u * i + 1u] += by_albedo.y;
    materials_gradient[4u * i + 2u] += by_albedo.z;
    materials_gradient[4u * i + 3u] += by_roughness;
    if (METALLIC) metallic_gradient[i] += dot(by_f0, albedo - 0.04) - dot(by_diffuse, albedo);

    // What is no number gives nothing.
    bool finite = finite_bits(environment_bound(i)) && finite_bits(dot(view + normal, vec3(1.0)));
    if (!finite || largest[0] == 0u) return;
    float units = power_of_two(fixed_exponent(largest[0]));
    vec3 by_reflected = units * g * factor, by_irradiance = units * (1.0 - metal) * g * albedo;
    Footprint sharp = cube_footprint(s.mirrored, s.sharper.x), blurred = cube_footprint(s.mirrored, s.blurrier.x);
    uvec2 last = levels[LEVELS - 1u];
    Footprint around = cube_footprint(normal, last.x);
    [[dont_unroll]] for (uint c = 0u; c < 4u; c++) {
        spread(sharp, c, s.sharper.y, (1.0 - s.part) * by_reflected);
        spread(blurred, c, s.blurrier.y, s.part * by_reflected);
        spread(around, c, last.y, by_irradiance);
    }
}

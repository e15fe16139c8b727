// Gradient of a view's loss by its camera's pose: a turn about the camera's center and a shift of the center, world axes.
// With the lens, also by the logarithm of the focal lengths, the shift of the principal point in focal lengths, and radial distortion.
//
// Reads what the backward pass of projection reads, before that changes the parameters. Relative to the center, so that
// nothing cancels in scenes far from the origin.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "distortion.glsl"
#include "work.glsl"
#include "splat.glsl"
#include "projection.glsl"
#include "gaussian.glsl"
#include "sh.glsl"
#include "project_bwd.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const uint CHANNELS = 3;
layout(constant_id = 4) const bool HAS_NORMALS = false;
layout(constant_id = 5) const bool HAS_DEPTH = false;
layout(constant_id = 6) const uint WEIGHTS = 0;
layout(constant_id = 8) const uint FEATURES = 0; // if their gradients reach opacities and footprints
layout(constant_id = 9) const bool LENS = false; // whether the lens is learned
layout(constant_id = 12) const bool REDUCED = false; // whether gradients are by splat, not by entry
layout(local_size_x_id = 0) in;
#include "channels.glsl"
#include "statistic.glsl"
#include "large_splats.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(uint, features);
IN(float, entry_gradients);
IN(float, entry_features);
IN(uint, entry_flags);
IN(uvec4, parameters);
OUT(float, camera_parts); // [workgroups * VALUES]: by the turn, by the shift, by focal lengths, principal point and distortion

#include "splat_sum.glsl"

const uint SUBGROUPS = (WORKGROUP + SUBGROUP - 1u) / SUBGROUP;

const uint VALUES = LENS ? 10u : 6u;

shared float camera_sums[VALUES * SUBGROUPS];

void main() {
    uint v = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    bool there = v < visible[0].count;
    float sums[SUMS];
    sum_entries(v, there, sums);
    vec3 turn = vec3(0.0), shift = vec3(0.0), lens = vec3(0.0);
    float radial = 0.0;
    if (there) {
        Visible s = visible_splat(v, sums);
        uint degree = min(SH_DEGREE, by_workgroup(params.step.sh_degree));
        float s_dot[16];
        [[unroll]] for (uint k = 0u; k < 16u; ++k) s_dot[k] = 0.0;
        uvec4 pair = uvec4(0u);
        // The first band has no direction.
        [[unroll]] for (uint c = 0u; c < harmonic_columns(SH_DEGREE); ++c) {
            if (SH_DEGREE == 0u || 4u * c >= harmonic_numbers(degree)) continue;
            vec4 values = harmonic_column(pair, s.gaussian, c);
            [[unroll]] for (uint j = 0u; j < 4u; ++j) {
                uint number = 4u * c + j;
                if (number < harmonic_numbers(degree)) s_dot[number / 3u] += values[j] * s.color[number % 3u];
            }
        }
        turn = s.gradient.camera_turn + cross(s.gradient.mean, s.mean - params.step.camera.position);
        shift = -(s.gradient.mean + direction_to_mean(s, degree, s_dot));
        if (LENS) {
            lens = s.gradient.lens;
            radial = s.gradient.radial;
        }
        // As the Gaussians are: those without a gradient, or with one that is not finite, say nothing.
        float all = dot(turn, vec3(1.0)) + dot(shift, vec3(1.0)) + dot(lens, vec3(1.0)) + radial;
        if (!s.touched || !is_finite(all)) {
            turn = shift = lens = vec3(0.0);
            radial = 0.0;
        }
    }
    [[unroll]] for (uint j = 0u; j < VALUES; ++j) {
        float value = j < 3u ? turn[j % 3u] : j < 6u ? shift[j % 3u] : j < 9u ? lens[j % 3u] : radial;
        float sum = subgroupAdd(value);
        if (subgroupElect()) camera_sums[j * SUBGROUPS + gl_SubgroupID] = sum;
    }
    barrier();
    if (gl_LocalInvocationID.x < VALUES) {
        float sum = 0.0;
        for (uint s = 0u; s < gl_NumSubgroups; ++s) sum += camera_sums[gl_LocalInvocationID.x * SUBGROUPS + s];
        // Folded grids have empty workgroups at their end.
        uint at = VALUES * folded_workgroup() + gl_LocalInvocationID.x;
        if (at < camera_parts.length()) camera_parts[at] = sum;
    }
}

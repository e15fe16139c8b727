// Backward of projection with every gradient written out: for tests, hosts with their own optimizer, and the camera
// pose. Training uses the form that is fused with Adam.
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

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const uint CHANNELS = 3;
layout(constant_id = 4) const bool HAS_NORMALS = false;
layout(constant_id = 5) const bool HAS_DEPTH = false;
layout(constant_id = 6) const uint WEIGHTS = 0;
layout(constant_id = 7) const bool POSE = false;
layout(constant_id = 8) const uint FEATURES = 0; // if their gradients reach opacities and footprints
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
OUT(vec4, gradients);    // in the columns of the moments
OUT(vec2, grad_means2d); // by visible splat, pixels
OUT(float, pose_partials); // [workgroups * 12]: rows of the rotation, then the translation

#include "splat_sum.glsl"

const uint SUBGROUPS = (WORKGROUP + SUBGROUP - 1u) / SUBGROUP;

shared float pose_sums[12 * SUBGROUPS];

void main() {
    uint v = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    bool real = v < visible[0].count;
    float sums[SUMS];
    sum_entries(v, real, sums);
    mat3 rows = mat3(0.0);
    vec3 translation = vec3(0.0);
    if (real) {
        Visible s = visible_splat(v, sums);
        uint degree = min(SH_DEGREE, by_workgroup(params.step.sh_degree));
        float basis[16];
        sh_basis(s.direction, degree, basis);
        float s_dot[16];
        [[unroll]] for (uint k = 0u; k < 16u; ++k) s_dot[k] = 0.0;
        uvec4 pair = uvec4(0u);
        [[unroll]] for (uint c = 0u; c < harmonic_columns(SH_DEGREE); ++c) {
            vec4 values = harmonic_column(pair, s.gaussian, c), by_values = vec4(0.0);
            [[unroll]] for (uint j = 0u; j < 4u; ++j) {
                uint number = 4u * c + j;
                if (number >= harmonic_numbers(SH_DEGREE)) continue;
                by_values[j] = basis[number / 3u] * s.color[number % 3u];
                s_dot[number / 3u] += values[j] * s.color[number % 3u];
            }
            gradients[moments_of(s.gaussian, HARMONICS + c)] = by_values;
        }
        vec3 by_direction = direction_to_mean(s, degree, s_dot);
        gradients[moments_of(s.gaussian, 0u)] = vec4(s.gradient.mean + by_direction, s.gradient.opacity_logit);
        gradients[moments_of(s.gaussian, 1u)] = vec4(s.gradient.log_scale, 0.0);
        gradients[moments_of(s.gaussian, 2u)] = s.gradient.rotation;
        grad_means2d[v] = s.gradient.mean2d;
        if (HAS_NORMALS) gradients[moments_of(s.gaussian, MOMENT_COLUMNS - 1u)] = vec4(s.normal, 0.0);
        if (POSE) {
            // The camera stands at -W^T t, and the direction moves against it: d/dt = W by_direction,
            // d/dW = t by_direction^T (as rows).
            mat3 w = camera_rotation(params.step.camera);
            vec3 t = vec3(params.step.camera.world_to_camera[0].w, params.step.camera.world_to_camera[1].w,
                          params.step.camera.world_to_camera[2].w);
            rows = s.gradient.camera_rows + mat3(t.x * by_direction, t.y * by_direction, t.z * by_direction);
            translation = s.gradient.camera_translation + w * by_direction;
        }
    }
    if (POSE) {
        [[unroll]] for (uint j = 0u; j < 12u; ++j) {
            float mine = j < 9u ? rows[min(j / 3u, 2u)][j % 3u] : translation[j % 3u];
            float sum = subgroupAdd(mine);
            if (subgroupElect()) pose_sums[j * SUBGROUPS + gl_SubgroupID] = sum;
        }
        barrier();
        if (gl_LocalInvocationID.x < 12u) {
            float sum = 0.0;
            for (uint s = 0u; s < gl_NumSubgroups; ++s) sum += pose_sums[gl_LocalInvocationID.x * SUBGROUPS + s];
            uint at = folded_workgroup() * 12u + gl_LocalInvocationID.x;
            if (at < pose_partials.length()) pose_partials[at] = sum;
        }
    }
}

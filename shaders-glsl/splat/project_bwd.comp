// Backward of projection with every gradient written out: for tests, hosts with their own optimizer, and the camera
// pose. Training uses the form that is fused with Adam.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "splat.glsl"
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
IN(vec3, means);
IN(vec3, log_scales);
IN(vec4, rotations);
IN(float, opacity_logits);
IN(vec3, sh1);
IN(vec3, sh2);
IN(vec3, sh3);
IN(vec3, normals);
OUT(vec3, grad_means);
OUT(vec3, grad_log_scales);
OUT(vec4, grad_rotations);
OUT(float, grad_opacity_logits);
OUT(vec3, grad_sh0);
OUT(vec3, grad_sh1);
OUT(vec3, grad_sh2);
OUT(vec3, grad_sh3);
OUT(vec3, grad_normals);
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
        uint i = s.gaussian;
        uint degree = min(SH_DEGREE, by_workgroup(params.step.sh_degree));
        float basis[16];
        sh_basis(s.direction, degree, basis);
        float s_dot[16];
        [[unroll]] for (uint k = 0u; k < 16u; ++k) s_dot[k] = 0.0;
        grad_sh0[i] = SH0 * s.color;
        if (SH_DEGREE >= 1u) [[unroll]] for (uint k = 0u; k < 3u; ++k) {
            grad_sh1[3u * i + k] = basis[1u + k] * s.color;
            s_dot[1u + k] = dot(sh1[3u * i + k], s.color);
        }
        if (SH_DEGREE >= 2u) [[unroll]] for (uint k = 0u; k < 5u; ++k) {
            grad_sh2[5u * i + k] = basis[4u + k] * s.color;
            s_dot[4u + k] = dot(sh2[5u * i + k], s.color);
        }
        if (SH_DEGREE >= 3u) [[unroll]] for (uint k = 0u; k < 7u; ++k) {
            grad_sh3[7u * i + k] = basis[9u + k] * s.color;
            s_dot[9u + k] = dot(sh3[7u * i + k], s.color);
        }
        vec3 by_direction = direction_to_mean(s, degree, s_dot);
        grad_means[i] = s.gradient.mean + by_direction;
        grad_log_scales[i] = s.gradient.log_scale;
        grad_rotations[i] = s.gradient.rotation;
        grad_opacity_logits[i] = s.gradient.opacity_logit;
        grad_means2d[v] = s.gradient.mean2d;
        if (HAS_NORMALS) grad_normals[i] = s.normal;
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

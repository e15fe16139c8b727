// Backward of projection fused with Adam: gradients of this view never reach memory.
//
// Gradients of other views (`extra`) are added. Only splats that were seen and touched move. A raised flag (an overflow
// earlier in the step) leaves everything unchanged.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"
#include "splat.glsl"
#include "sh.glsl"
#include "project_bwd.glsl"
#include "extra.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const uint CHANNELS = 3;
layout(constant_id = 4) const bool HAS_NORMALS = false;
layout(constant_id = 5) const bool HAS_DEPTH = false;
layout(constant_id = 6) const uint WEIGHTS = 0;
layout(constant_id = 7) const bool STATISTICS = false;
layout(constant_id = 8) const bool MARK_SEEN = false; // for dense Adam
layout(constant_id = 9) const uint FEATURES = 0; // if their gradients reach opacities and footprints
layout(constant_id = 10) const bool EXTRA = false; // whether other views left gradients
layout(constant_id = 12) const bool REDUCED = false; // whether gradients are by splat, not by entry
layout(local_size_x_id = 0) in;
#include "channels.glsl"
#include "statistic.glsl"
#include "large_splats.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(uint, flags);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(uint, features);
IN(float, entry_gradients);
IN(float, entry_features);
IN(uint, entry_flags);
IN(float, extra); // [Gaussians * EXTRA_WIDTH]
INOUT(vec3, means);
INOUT(vec3, log_scales);
INOUT(vec4, rotations);
INOUT(float, opacity_logits);
INOUT(vec3, sh0);
INOUT(vec3, sh1);
INOUT(vec3, sh2);
INOUT(vec3, sh3);
INOUT(vec3, normals);
INOUT(vec2, means_moments);
INOUT(vec2, log_scales_moments);
INOUT(vec2, rotations_moments);
INOUT(vec2, opacity_logits_moments);
INOUT(vec2, sh0_moments);
INOUT(vec2, sh1_moments);
INOUT(vec2, sh2_moments);
INOUT(vec2, sh3_moments);
INOUT(vec2, normals_moments);
INOUT(vec4, statistics);  // by Gaussian: sum of screen gradients, count, sum of weights, sum of gradients by the raw normal
INOUT(uint, skipped);     // splats whose gradients were not finite
OUT(uint, seen);          // by Gaussian: whether it was updated here; with `extra`, also if it was skipped here

#include "splat_sum.glsl"

// One vector of a group: N scalars from `at`.
#define UPDATE(group, N, value, gradient, at, rate)                                                        \
    [[unroll]] for (uint j_ = 0u; j_ < N; ++j_) {                                                          \
        float p_ = value[j_];                                                                              \
        vec2 m_ = group##_moments[(at) + j_];                                                              \
        adam(p_, m_, gradient[j_], rate, params.step.correction1, params.step.correction2);                \
        value[j_] = p_;                                                                                    \
        group##_moments[(at) + j_] = m_;                                                                   \
    }

void main() {
    if (flags[0] != 0u) return;
    uint v = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    bool there = v < visible[0].count;
    float sums[SUMS];
    sum_entries(v, there, sums);
    if (!there) return;
    Visible s = visible_splat(v, sums);
    uint i = s.gaussian;
    if (STATISTICS && by_workgroup(params.step.gather_statistics) != 0u) {
        float screen = length(s.statistic * 0.5 * vec2(params.step.camera.size));
        float by_normal = STATISTIC == STATISTIC_GEOMETRIC && HAS_NORMALS ? length(s.normal) : 0.0;
        vec3 sums = vec3(screen, s.weight, by_normal);
        sums = mix(vec3(0.0), sums, bvec3(is_finite(sums.x), is_finite(sums.y), is_finite(sums.z)));
        statistics[i] += vec4(sums.x, 1.0, sums.yz);
    }
    bool touched = s.touched;
    vec3 gm = s.gradient.mean, gs = s.gradient.log_scale;
    vec4 gr = s.gradient.rotation;
    float go = s.gradient.opacity_logit;
    if (EXTRA) {
        if (!s.touched) {
            // What projection makes of zeros need not be zeros.
            gm = gs = s.color = s.normal = vec3(0.0);
            gr = vec4(0.0);
            go = 0.0;
        }
        uint any_extra = 0u;
        float more[EXTRA_WIDTH];
        [[unroll]] for (uint j = 0u; j < EXTRA_WIDTH; ++j) {
            more[j] = extra[i * EXTRA_WIDTH + j];
            any_extra |= magnitude_bits(more[j]);
        }
        gm += vec3(more[0], more[1], more[2]);
        gs += vec3(more[3], more[4], more[5]);
        gr += vec4(more[6], more[7], more[8], more[9]);
        go += more[10];
        touched = touched || any_extra != 0u;
    }
    if (!touched) return;
    // Another pass moves the unmarked Gaussians by the extra gradients alone; Gaussians skipped here must not move there.
    if (EXTRA && MARK_SEEN) seen[i] = 1u;
    float check = dot(gm, vec3(1.0)) + dot(gs, vec3(1.0)) + dot(gr, vec4(1.0)) + go +
                  dot(s.color, vec3(1.0)) + dot(s.normal, vec3(1.0));
    if (!is_finite(check)) {
        atomicAdd(skipped[0], 1u);
        return;
    }
    if (MARK_SEEN && !EXTRA) seen[i] = 1u;
    uint degree = min(SH_DEGREE, by_workgroup(params.step.sh_degree));
    float basis[16];
    sh_basis(s.direction, degree, basis);
    float s_dot[16];
    [[unroll]] for (uint k = 0u; k < 16u; ++k) s_dot[k] = 0.0;
    vec3 c0 = sh0[i];
    vec3 g0 = SH0 * s.color;
    UPDATE(sh0, 3u, c0, g0, 3u * i, params.step.lr_sh0)
    sh0[i] = c0;
    // Bands above the active degree have no gradient yet and stay as they are.
    if (SH_DEGREE >= 1u && degree >= 1u) [[unroll]] for (uint k = 0u; k < 3u; ++k) {
        vec3 c = sh1[3u * i + k];
        s_dot[1u + k] = dot(c, s.color);
        vec3 g = basis[1u + k] * s.color;
        UPDATE(sh1, 3u, c, g, 9u * i + 3u * k, params.step.lr_sh_rest)
        sh1[3u * i + k] = c;
    }
    if (SH_DEGREE >= 2u && degree >= 2u) [[unroll]] for (uint k = 0u; k < 5u; ++k) {
        vec3 c = sh2[5u * i + k];
        s_dot[4u + k] = dot(c, s.color);
        vec3 g = basis[4u + k] * s.color;
        UPDATE(sh2, 3u, c, g, 15u * i + 3u * k, params.step.lr_sh_rest)
        sh2[5u * i + k] = c;
    }
    if (SH_DEGREE >= 3u && degree >= 3u) [[unroll]] for (uint k = 0u; k < 7u; ++k) {
        vec3 c = sh3[7u * i + k];
        s_dot[9u + k] = dot(c, s.color);
        vec3 g = basis[9u + k] * s.color;
        UPDATE(sh3, 3u, c, g, 21u * i + 3u * k, params.step.lr_sh_rest)
        sh3[7u * i + k] = c;
    }
    gm += direction_to_mean(s, degree, s_dot);
    vec3 mean = s.mean;
    UPDATE(means, 3u, mean, gm, 3u * i, params.step.lr_means)
    means[i] = mean;
    vec3 log_scale = s.log_scale;
    UPDATE(log_scales, 3u, log_scale, gs, 3u * i, params.step.lr_scales)
    log_scales[i] = log_scale;
    vec4 rotation = s.rotation;
    UPDATE(rotations, 4u, rotation, gr, 4u * i, params.step.lr_rotations)
    rotations[i] = rotation;
    float logit = opacity_logits[i];
    vec2 m = opacity_logits_moments[i];
    adam(logit, m, go, params.step.lr_opacities, params.step.correction1,
         params.step.correction2);
    opacity_logits[i] = logit;
    opacity_logits_moments[i] = m;
    if (HAS_NORMALS) {
        vec3 n = normals[i];
        UPDATE(normals, 3u, n, s.normal, 3u * i, params.step.lr_normals)
        normals[i] = n;
    }
}

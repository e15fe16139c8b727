// Backward of projection fused with Adam: gradients of this view never reach memory.
//
// Gradients of other views (`extra`) are added. Only splats that were seen and touched move. A raised flag (an overflow
// earlier in the step) leaves everything unchanged.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "distortion.glsl"
#include "work.glsl"
#include "adam.glsl"
#include "splat.glsl"
#include "projection.glsl"
#include "gaussian.glsl"
#include "sh.glsl"
#include "project_bwd.glsl"
#include "extra.glsl"
#include "regularize.glsl"

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
layout(constant_id = 11) const bool REGULARIZE = false; // opacities and scales, for Markov chain Monte Carlo
layout(constant_id = 12) const bool REDUCED = false; // whether gradients are by splat, not by entry
layout(local_size_x_id = 0) in;
#include "channels.glsl"
#include "statistic.glsl"
#include "large_splats.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible); // three records of the visible splats; with regularizers, one of all Gaussians
IN(uint, flags);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(uint, features);
IN(float, entry_gradients);
IN(float, entry_features);
IN(uint, entry_flags);
IN(float, extra); // [Gaussians * EXTRA_WIDTH]
INOUT(uvec4, parameters);
INOUT(uvec4, first_moments);
INOUT(uvec4, second_moments);
INOUT(vec4, statistics);  // by Gaussian: sum of screen gradients, count, sum of weights, sum of gradients by the raw normal
INOUT(uint, skipped);     // splats whose gradients were not finite
OUT(uint, seen);          // by Gaussian: whether it was updated here; with `extra`, also if it was skipped here

const uint GAUSSIANS = 3u; // their record

#include "splat_sum.glsl"
#include "adam_columns.glsl"

// One step of a column, whose moments it writes; numbers outside the mask stay as they are.
vec4 update(uint i, uint column, uint key, vec4 values, vec4 by_values, vec4 rates, bvec4 mask) {
    vec4 first, second;
    read_moments(i, column, first, second);
    [[unroll]] for (uint j = 0u; j < 4u; ++j) {
        if (!mask[j]) continue;
        float value = values[j];
        vec2 moments = vec2(first[j], second[j]);
        adam(value, moments, by_values[j], rates[j], params.step.correction1, params.step.correction2);
        values[j] = value;
        first[j] = moments.x;
        second[j] = moments.y;
    }
    write_moments(i, column, key, first, second);
    return values;
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
    if (REGULARIZE) {
        gs += scale_regularizer(params.step.weight_scale, visible[GAUSSIANS].count, s.log_scale);
        go += opacity_regularizer(params.step.weight_opacity, visible[GAUSSIANS].count, s.opacity_logit);
    }
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
    uint key = COMPACT ? rounding_key(params.step.seed, i) : 0u;
    uvec4 pair = uvec4(0u);
    // Bands above the active degree have no gradient yet and stay as they are.
    [[unroll]] for (uint c = 0u; c < harmonic_columns(SH_DEGREE); ++c) {
        if (4u * c >= harmonic_numbers(degree)) continue;
        vec4 values = harmonic_column(pair, i, c), by_values = vec4(0.0), rates;
        bvec4 mask;
        [[unroll]] for (uint j = 0u; j < 4u; ++j) {
            uint number = 4u * c + j;
            mask[j] = number < harmonic_numbers(degree);
            rates[j] = number < 3u ? params.step.lr_sh0 : params.step.lr_sh_rest;
            if (number >= harmonic_numbers(SH_DEGREE)) continue;
            by_values[j] = basis[number / 3u] * s.color[number % 3u];
            if (mask[j]) s_dot[number / 3u] += values[j] * s.color[number % 3u];
        }
        write_harmonics(i, c, key, update(i, HARMONICS + c, key, values, by_values, rates, mask));
    }
    gm += direction_to_mean(s, degree, s_dot);
    const bvec4 THREE = bvec4(true, true, true, false);
    vec4 place_rates = vec4(vec3(params.step.lr_means), params.step.lr_opacities);
    write_column(i, 0u, update(i, 0u, key, vec4(s.mean, s.opacity_logit), vec4(gm, go), place_rates, bvec4(true)));
    vec4 size_rates = vec4(params.step.lr_scales);
    write_column(i, 1u, update(i, 1u, key, parameter_column(i, 1u), vec4(gs, 0.0), size_rates, THREE));
    write_column(i, 2u, update(i, 2u, key, s.rotation, gr, vec4(params.step.lr_rotations), bvec4(true)));
    if (HAS_NORMALS) {
        vec4 raw = parameter_column(i, COLUMNS - 1u), rates = vec4(params.step.lr_normals);
        write_column(i, COLUMNS - 1u, update(i, MOMENT_COLUMNS - 1u, key, raw, vec4(s.normal, 0.0), rates, THREE));
    }
}

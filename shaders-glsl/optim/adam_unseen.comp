// Adam for the Gaussians that the fused update of a step did not move.
//
// Their gradient is that of other views and of regularizers, or zero. Then either moments decay and carry the parameters on (dense
// Adam), or the Gaussians are left unchanged.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"
#include "gaussian.glsl"
#include "extra.glsl"
#include "splat.glsl"
#include "regularize.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool EXTRA = false;       // whether other views left gradients; all are zero without
layout(constant_id = 2) const bool SPARSE = false;      // an exactly-zero gradient leaves its scalar untouched
layout(constant_id = 4) const bool REGULARIZE = false;  // opacities and scales, for Markov chain Monte Carlo
layout(constant_id = 3) const bool HAS_NORMALS = false; // in the last column

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, live);
IN(uint, flags);
IN(uint, seen);  // nonzero for Gaussians that this pass must skip
IN(float, extra); // [Gaussians * EXTRA_WIDTH]
INOUT(uvec4, parameters);
INOUT(uvec4, first_moments);
INOUT(uvec4, second_moments);
INOUT(uint, skipped); // Gaussians whose gradients were not finite

#include "adam_columns.glsl"

vec4 rates_of(uint column) {
    if (column == 0u) return vec4(vec3(params.step.lr_means), params.step.lr_opacities);
    if (column == 1u) return vec4(params.step.lr_scales);
    if (column == 2u) return vec4(params.step.lr_rotations);
    if (HAS_NORMALS && column == MOMENT_COLUMNS - 1u) return vec4(params.step.lr_normals);
    if (column == HARMONICS) return vec4(vec3(params.step.lr_sh0), params.step.lr_sh_rest);
    return vec4(params.step.lr_sh_rest);
}

// Moves the values of a column, and writes their moments if any of them changed.
bool update(uint i, uint column, uint key, inout vec4 values, vec4 by_values, vec4 rates) {
    vec4 first, second;
    read_moments(i, column, first, second);
    bool changed = false;
    [[unroll]] for (uint j = 0u; j < 4u; ++j) {
        if (SPARSE && is_zero(by_values[j])) continue;
        // What never had a gradient stays exactly as it is.
        if (is_zero(by_values[j]) && is_zero(first[j]) && is_zero(second[j])) continue;
        float value = values[j];
        vec2 moments = vec2(first[j], second[j]);
        adam(value, moments, by_values[j], rates[j], params.step.correction1, params.step.correction2);
        values[j] = value;
        first[j] = moments.x;
        second[j] = moments.y;
        changed = true;
    }
    if (changed) write_moments(i, column, key, first, second);
    return changed;
}

// Moves a column that compact storage keeps in 32 bits. Its parameters and its moments may have different columns.
void update_column(uint i, uint column, uint moments, uint key, vec4 by_values) {
    vec4 values = parameter_column(i, column);
    if (update(i, moments, key, values, by_values, rates_of(moments))) write_column(i, column, values);
}

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= live[0].count || flags[0] != 0u || seen[i] != 0u) return;
    uint key = COMPACT ? rounding_key(params.step.seed, i) : 0u;
    vec4 by_place = vec4(0.0), by_size = vec4(0.0), by_rotation = vec4(0.0);
    bool finite = true;
    if (EXTRA) {
        float more[EXTRA_WIDTH];
        [[unroll]] for (uint j = 0u; j < EXTRA_WIDTH; ++j) {
            more[j] = extra[i * EXTRA_WIDTH + j];
            finite = finite && is_finite(more[j]);
        }
        by_place = vec4(more[0], more[1], more[2], more[10]);
        by_size = vec4(more[3], more[4], more[5], 0.0);
        by_rotation = vec4(more[6], more[7], more[8], more[9]);
        if (!finite) atomicAdd(skipped[0], 1u);
    }
    if (REGULARIZE) {
        by_place.w += opacity_regularizer(params.step.weight_opacity, live[0].count, parameter_column(i, 0u).w);
        by_size.xyz += scale_regularizer(params.step.weight_scale, live[0].count, parameter_column(i, 1u).xyz);
    }
    if (finite) {
        update_column(i, 0u, 0u, key, by_place);
        update_column(i, 1u, 1u, key, by_size);
        update_column(i, 2u, 2u, key, by_rotation);
    }
    if (SPARSE) return;
    uvec4 pair = uvec4(0u);
    for (uint column = HARMONICS; column < MOMENT_COLUMNS - uint(HAS_NORMALS); ++column) {
        uint c = column - HARMONICS;
        vec4 values = harmonic_column(pair, i, c);
        if (update(i, column, key, values, vec4(0.0), rates_of(column))) write_harmonics(i, c, key, values);
    }
    if (HAS_NORMALS) update_column(i, COLUMNS - 1u, MOMENT_COLUMNS - 1u, key, vec4(0.0));
}

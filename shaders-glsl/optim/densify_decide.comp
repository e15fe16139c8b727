// Densification, step 1: decides on every Gaussian, and counts the decisions by kind.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "adam.glsl"
#include "densify.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(Work, live);
IN(uvec4, parameters);
IN(vec4, statistics);  // by Gaussian: sum of screen gradients, count, sum of weights, sum of gradients by the raw normal
OUT(uint, verdicts);
INOUT(uint, counters);

#include "parameter_columns.glsl"

bool finite(vec3 v) { return is_finite(v.x) && is_finite(v.y) && is_finite(v.z); }

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= live[0].count) return;
    vec4 place = parameter_column(i, 0u), rotation = parameter_column(i, 2u);
    vec3 log_scale = parameter_column(i, 1u).xyz;
    uvec4 pair;
    float logit = place.w;
    bool valid = finite(place.xyz) && finite(log_scale) && finite(rotation.xyz) && is_finite(rotation.w)
              && is_finite(logit) && finite(harmonic_column(pair, i, 0u).xyz);
    // Both clamped where the exponential of a 32-bit number still is one.
    float opacity = 1.0 / (1.0 + exp(-clamp(logit, -80.0, 80.0)));
    float largest = exp(clamp(max(max(log_scale.x, log_scale.y), log_scale.z), -80.0, 80.0));
    Densify d = params.densify;
    bool faint = opacity < d.prune_opacity;
    vec4 gathered = statistics[i];
    bool weightless = valid && !faint && gathered.z < d.prune_weight;
    bool prune = !valid || faint || weightless || largest > d.prune_size;
    float count = max(gathered.y, 1.0);
    float gradient = gathered.x / count;
    bool refine = is_finite(gradient) && gradient >= d.grad_threshold;
    if (d.normal_threshold > 0.0 && is_finite(gradient)) {
        float by_normal = gathered.w / count;
        refine = refine || by_normal >= d.normal_threshold;
        // Under the cap the two gradients compete by their multiples of their thresholds.
        gradient = max(gradient, by_normal / d.normal_threshold * d.grad_threshold);
    }
    refine = refine && !prune;
    uint verdict = prune ? PRUNE : KEEP;
    if (refine) {
        uint strength = strength_of(gradient);
        verdict = (largest > d.split_size ? SPLIT : CLONE) | strength << VERDICT_BITS;
        atomicAdd(counters[COUNT_STRENGTHS + strength - 1u], 1u);
    }
    verdicts[i] = verdict;
    if (prune && valid) atomicMax(counters[COUNT_SPARED], ~i);
    // One addition by subgroup: all of them go to the same words.
    uint pruned = subgroupAdd(uint(prune)), invalid = subgroupAdd(uint(!valid)), refined = subgroupAdd(uint(refine));
    uint unseen = subgroupAdd(uint(weightless));
    if (subgroupElect()) {
        atomicAdd(counters[COUNT_PRUNED], pruned);
        atomicAdd(counters[COUNT_INVALID], invalid);
        atomicAdd(counters[COUNT_REFINED], refined);
        atomicAdd(counters[COUNT_WEIGHTLESS], unseen);
    }
}

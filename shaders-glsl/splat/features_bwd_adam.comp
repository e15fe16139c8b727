// Gradients of raw features summed over the entries of each visible splat, and Adam on the spot. A feature whose gradient
// is exactly zero was not seen and stays as it is, unless Adam is dense; a raised flag leaves everything as it was.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint FEATURES = 32;
layout(constant_id = 2) const bool DENSE = false; // then `seen` says which are left to another pass
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(uint, flags);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(float, entry_features); // [entries * (6 + FEATURES)], moments first
IN(uint, entry_flags);
IN(uint, seen);
INOUT(float, parameters);
INOUT(vec2, moments);

void main() {
    if (flags[0] != 0u) return;
    uint first = folded_workgroup() * WORKGROUP;
    for (uint item = gl_LocalInvocationID.x; item < WORKGROUP * FEATURES; item += WORKGROUP) {
        uint v = first + item / FEATURES, c = item % FEATURES;
        if (v >= visible[0].count) break;
        uint i = splat_ids[v];
        if (DENSE && seen[i] == 0u) continue;
        float sum = 0.0;
        uint begin = entry_starts[v], end = begin + tile_counts[v];
        for (uint e = begin; e < end; ++e)
            if (entry_flags[e] != 0u) sum += entry_features[e * (6u + FEATURES) + 6u + c];
        if (!DENSE && sum == 0.0) continue;
        float parameter = parameters[i * FEATURES + c];
        vec2 m = moments[i * FEATURES + c];
        adam(parameter, m, sum, params.step.lr_semantics, params.step.correction1, params.step.correction2);
        parameters[i * FEATURES + c] = parameter;
        moments[i * FEATURES + c] = m;
    }
}

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

#include "entry_features.glsl"

void main() {
    if (flags[0] != 0u) return;
    // Lanes have four of a splat's features each, side by side.
    const uint quads = FEATURES / 4u;
    uint first = folded_workgroup() * WORKGROUP;
    for (uint item = gl_LocalInvocationID.x; item < WORKGROUP * quads; item += WORKGROUP) {
        uint v = first + item / quads, c = item % quads * 4u;
        if (v >= visible[0].count) break;
        uint i = splat_ids[v];
        if (DENSE && seen[i] == 0u) continue;
        vec4 sum = entry_sum(v, c);
        if (!DENSE && sum == vec4(0.0)) continue;
        [[unroll]] for (uint k = 0u; k < 4u; ++k) {
            if (!DENSE && sum[k] == 0.0) continue;
            uint at = i * FEATURES + c + k;
            float parameter = parameters[at];
            vec2 m = moments[at];
            adam(parameter, m, sum[k], params.step.lr_semantics, params.step.correction1, params.step.correction2);
            parameters[at] = parameter;
            moments[at] = m;
        }
    }
}

// Gradients of raw features: the sums over the entries of each visible splat, in their order, added to what other views
// left. A step of one view fuses them with Adam instead (features_bwd_adam).
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint FEATURES = 32;
layout(local_size_x_id = 0) in;

IN(Work, visible);
IN(uint, splat_ids);
IN(uint, entry_starts);
IN(uint, tile_counts);
IN(float, entry_features); // [entries * (6 + FEATURES)], moments first
IN(uint, entry_flags);
INOUT(float, grad_features); // [Gaussians * FEATURES]; those that are not visible stay as they are

#include "entry_features.glsl"

void main() {
    // A workgroup does WORKGROUP splats; lanes have four of a splat's features each, side by side.
    const uint quads = FEATURES / 4u;
    uint first = folded_workgroup() * WORKGROUP;
    for (uint item = gl_LocalInvocationID.x; item < WORKGROUP * quads; item += WORKGROUP) {
        uint v = first + item / quads, c = item % quads * 4u;
        if (v >= visible[0].count) break;
        vec4 sum = entry_sum(v, c);
        if (sum == vec4(0.0)) continue;
        uint at = splat_ids[v] * FEATURES + c;
        [[unroll]] for (uint k = 0u; k < 4u; ++k) grad_features[at + k] += sum[k];
    }
}

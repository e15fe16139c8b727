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

void main() {
    // A workgroup does WORKGROUP splats, lanes side by side on the features of one.
    uint first = folded_workgroup() * WORKGROUP;
    for (uint item = gl_LocalInvocationID.x; item < WORKGROUP * FEATURES; item += WORKGROUP) {
        uint v = first + item / FEATURES, c = item % FEATURES;
        if (v >= visible[0].count) break;
        float sum = 0.0;
        uint begin = entry_starts[v], end = begin + tile_counts[v];
        for (uint e = begin; e < end; ++e)
            if (entry_flags[e] != 0u) sum += entry_features[e * (6u + FEATURES) + 6u + c];
        grad_features[splat_ids[v] * FEATURES + c] += sum;
    }
}

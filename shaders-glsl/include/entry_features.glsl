// Four features' gradients of a visible splat, summed over its entries in their order. Entries that show nowhere were not
// written, and their flag is down. Needs FEATURES, a multiple of four, and the buffers named here.

vec4 entry_sum(uint v, uint c) {
    vec4 sum = vec4(0.0);
    uint begin = entry_starts[v], end = begin + tile_counts[v];
    // Of splats of which a tile wants little most entries are skipped, by a loop of its own: processors that run lanes in
    // lockstep save nothing by a branch.
    for (uint e = begin;; ++e) {
        while (e < end && entry_flags[e] == 0u) ++e;
        if (e >= end) break;
        uint at = e * (6u + FEATURES) + 6u + c;
        sum += vec4(entry_features[at], entry_features[at + 1u], entry_features[at + 2u], entry_features[at + 3u]);
    }
    return sum;
}

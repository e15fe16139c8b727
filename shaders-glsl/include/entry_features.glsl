// Four features' gradients of a visible splat, summed over its entries in their order. Entries that show nowhere were not
// written, and their flag is down. Needs FEATURES, a multiple of four, and the buffers named here.

vec4 entry_sum(uint v, uint c) {
    vec4 sum = vec4(0.0);
    uint begin = entry_starts[v], end = begin + tile_counts[v];
    for (uint e = begin; e < end; ++e) {
        if (entry_flags[e] == 0u) continue;
        uint at = e * (6u + FEATURES) + 6u + c;
        sum += vec4(entry_features[at], entry_features[at + 1u], entry_features[at + 2u], entry_features[at + 3u]);
    }
    return sum;
}

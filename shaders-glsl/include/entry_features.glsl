// Gradients of visible splats' features, summed over their entries in order.
//
// An entry that covers no selected pixel was not written, and its flag is 0. Needs SUBGROUP, FEATURES (a multiple of four)
// and the buffers named here. A subgroup does as many splats as it has lanes. First each lane reads one splat: the range of
// its entries, and their flags. Then lanes hold four features each, side by side, of one splat or of several.

const uint QUADS = FEATURES / 4u;

struct EntrySplat {
    uint start, count; // of its entries
    uint shows;        // of the first 32 entries, a bit each
};

EntrySplat entry_splat(uint v, bool there) {
    EntrySplat s = EntrySplat(0u, 0u, 0u);
    if (there) s = EntrySplat(entry_starts[v], tile_counts[v], 0u);
    for (uint e = 0u; e < min(s.count, 32u); ++e) s.shows |= uint(entry_flags[s.start + e] != 0u) << e;
    return s;
}

void add_entry(inout vec4 sum, uint e, uint c) {
    uint at = e * (6u + FEATURES) + 6u + c;
    sum += vec4(entry_features[at], entry_features[at + 1u], entry_features[at + 2u], entry_features[at + 3u]);
}

// The sum of the four features from `c` on of the splat that lane `of` selected.
vec4 entry_sum(EntrySplat mine, uint of, uint c) {
    vec4 sum = vec4(0.0);
    uint start = subgroupShuffle(mine.start, of), end = start + subgroupShuffle(mine.count, of);
    uint shows = subgroupShuffle(mine.shows, of);
    while (shows != 0u) {
        add_entry(sum, start + findLSB(shows), c);
        shows &= shows - 1u;
    }
    // Of splats of which a tile wants little most entries are skipped, by a loop of its own: processors that run lanes in
    // lockstep save nothing by a branch.
    for (uint e = start + 32u;; ++e) {
        while (e < end && entry_flags[e] == 0u) ++e;
        if (e >= end) break;
        add_entry(sum, e, c);
    }
    return sum;
}

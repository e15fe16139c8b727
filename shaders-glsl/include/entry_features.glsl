// Gradients of visible splats' features, summed over their entries.
//
// An entry that covers no selected pixel was not written, and its flag is 0. Needs SUBGROUP, FEATURES (a multiple of four,
// at most four a lane), the buffers named here and large_splats.glsl. A subgroup does as many splats as it has lanes. First
// each lane reads one splat: the range of its entries, and their flags. Then lanes hold four features each, side by side, of
// one splat or of several, and add the entries in order. Large splats follow, one after the other.

const uint QUADS = FEATURES / 4u;

struct EntrySplat {
    uint start, count; // of its entries
    uint shows;        // of the first 32 entries, a bit each
    uint large_count;  // of the entries of a large splat, whose `count` is 0
};

EntrySplat entry_splat(uint v, bool there) {
    EntrySplat s = EntrySplat(0u, 0u, 0u, 0u);
    if (there) s = EntrySplat(entry_starts[v], tile_counts[v], 0u, 0u);
    if (s.count > LARGE_TILES) {
        s.large_count = s.count;
        s.count = 0u;
    }
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

const uint SLOTS = SUBGROUP / QUADS; // entries of a large splat that the lanes add at a time

uint large_column() { return gl_SubgroupInvocationID % QUADS * 4u; }

// The sum of the four features from `large_column` on of the large splat that lane `of` selected. Each slot adds every
// SLOTS-th entry, then the slots are added by a fixed tree.
vec4 large_entry_sum(EntrySplat mine, uint of) {
    uint start = subgroupShuffle(mine.start, of), count = subgroupShuffle(mine.large_count, of);
    vec4 sum = vec4(0.0);
    for (uint first = 0u; first < count; first += SUBGROUP) {
        uint own = first + gl_SubgroupInvocationID;
        uvec4 shows = subgroupBallot(own < count && entry_flags[start + min(own, count - 1u)] != 0u);
        if (all(equal(shows, uvec4(0u)))) continue;
        for (uint k = gl_SubgroupInvocationID / QUADS; k < SUBGROUP; k += SLOTS) {
            if (subgroupBallotBitExtract(shows, k)) add_entry(sum, start + first + k, large_column());
        }
    }
    [[unroll]] for (uint k = 0u; k < 7u; ++k) {
        uint reach = QUADS << k;
        if (reach < SUBGROUP) sum += subgroupShuffleXor(sum, reach);
    }
    return sum;
}

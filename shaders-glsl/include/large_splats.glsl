// Splats of so many tiles that the lanes of a subgroup process each of them together, one splat after the other.
//
// One lane that walks all tiles of a splat makes the others wait: one splat over a 1080p image has 8160 tiles. Needs
// SUBGROUP. Every lane calls these functions, from control flow that is uniform in the subgroup.

layout(constant_id = 28) const uint LARGE_TILES = 128; // a splat of more tiles is large

// The first lane of a ballot, which must have one; it leaves the ballot.
uint next_large(inout uvec4 votes) {
    uint lane = subgroupBallotFindLSB(votes);
    [[unroll]] for (uint w = 0u; w < 4u; ++w) {
        if (w == lane / 32u) votes[w] &= votes[w] - 1u;
    }
    return lane;
}

// Sum over the lanes, by a fixed tree; every lane has the same bits.
float lane_tree_sum(float value) {
    [[unroll]] for (uint k = 0u; k < 7u; ++k) {
        if ((1u << k) < SUBGROUP) value += subgroupShuffleXor(value, 1u << k);
    }
    return value;
}

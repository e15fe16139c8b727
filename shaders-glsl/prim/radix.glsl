// What the kernels of the radix sort share: the digit, and which lanes of a subgroup have the same one.
// Needs BITS, SUBGROUP and `push.shift`.
const uint BINS = 1u << BITS;

uint digit_of(uint key) { return (key >> push.shift) & (BINS - 1u); }

// The lanes with this lane's digit: how many come before it, and which is the last.
struct Peers {
    uint before;
    uint last;
};

// Lanes that are not `valid` have no peers. Uniform control flow.
Peers find_peers(uint digit, bool valid) {
    Peers peers = Peers(0u, gl_SubgroupInvocationID);
    if (SUBGROUP <= BITS) {
        // Fewer lanes than bits: comparing with each lane is shorter than voting on each bit.
        uint mine = valid ? digit : ~gl_SubgroupInvocationID;
        [[unroll]] for (uint lane = 0u; lane < SUBGROUP; ++lane) {
            bool same = subgroupBroadcast(mine, lane) == mine;
            peers.before += uint(same && lane < gl_SubgroupInvocationID);
            if (same) peers.last = lane;
        }
    } else {
        uvec4 mask = subgroupBallot(valid);
        [[unroll]] for (uint bit = 0u; bit < BITS; ++bit) {
            bool set = (digit >> bit & 1u) != 0u;
            uvec4 votes = subgroupBallot(set);
            mask &= set ? votes : ~votes;
        }
        if (valid) {
            peers.before = subgroupBallotExclusiveBitCount(mask);
            peers.last = subgroupBallotFindMSB(mask);
        }
    }
    return peers;
}

// Tests a batch of entries, one a lane, against the selected pixels that a subgroup processes at a time.
//
// Selected pixels are few and splats are small, so most entries of a tile cover none of them. The test is conservative (by
// far more than rounding): it rejects only entries that cannot contribute. Needs constants SUBGROUP and PER_LANE.

#include "next_lane.glsl"

// Whether an entry is tried only at those pixels of a lane, by number, where it shows in some lane.
layout(constant_id = 29) const bool SUB_TILES = true;

layout(constant_id = 32) const float SLOT_MARGIN = 0.05; // of the exponent; a huge one leaves every entry in

// A ballot of the lanes whose entry shows at one of the lanes' pixels; `there` says which lanes have an entry. Bit k of
// `slots` says whether this lane's entry shows at the k-th pixel of a lane. All lanes hand their pixels round: fetching each
// from the list would be a load a lane.
uvec4 lane_hits(Splat s, bool there, vec2 center[PER_LANE], out uint slots) {
    slots = 0u;
    float limit = log2(s.opacity / ALPHA_MIN) + SLOT_MARGIN;
    [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
        bool hit = false;
        [[unroll]] for (uint j = 0u; j < SUBGROUP; ++j) {
            float dx = subgroupShuffle(center[k].x, j) - s.mean.x, dy = subgroupShuffle(center[k].y, j) - s.mean.y;
            float p = s.factor.x * dx + s.factor.y * dy;
            float q = s.factor.z * dy;
            hit = hit || p * p + q * q <= limit;
        }
        slots |= uint(hit) << k;
    }
    return subgroupBallot(there && slots != 0u);
}

bool in_slots(uint slots, uint k) { return !SUB_TILES || (slots & (1u << k)) != 0u; }

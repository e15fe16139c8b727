// Compact list of the set bits of a mask; cost follows the number of set bits.
//
// A workgroup, which is one subgroup, visits every n-th block of the mask and processes the list when it is nearly full.
// Needs SUBGROUP and MASK(word), the mask's words.

layout(constant_id = 33) const uint LANE_PIXELS = 16; // a power of two up to 32; Tuning::lane_pixels
const uint BLOCK = LANE_PIXELS * SUBGROUP;            // pixels whose words the lanes fetch at once
const uint ROOM = BLOCK + 768u;

shared uint listed[ROOM];

uint list_blocks(uint pixels) { return (pixels + BLOCK - 1u) / BLOCK; }

// Fills the list with pixels of `block` and following ones, in order; returns its length.
uint fill_list(inout uint block, uint pixels) {
    uint blocks = list_blocks(pixels), count = 0u;
    // Somebody may still read the list.
    subgroupMemoryBarrierShared();
    subgroupBarrier();
    while (block < blocks && count <= ROOM - BLOCK) {
        uint first = block * BLOCK + gl_SubgroupInvocationID * LANE_PIXELS;
        uint bits = 0u, left = pixels - min(first, pixels);
        if (left > 0u) bits = MASK(first / 32u);
        if (LANE_PIXELS < 32u) bits = bits >> (first % 32u) & ((1u << LANE_PIXELS % 32u) - 1u);
        if (left < LANE_PIXELS) bits &= (1u << left) - 1u;
        uint mine = bitCount(bits);
        uint at = count + subgroupExclusiveAdd(mine), most = subgroupMax(mine);
        count += subgroupAdd(mine);
        for (uint n = 0u; n < most; n++) {
            if (bits != 0u) {
                listed[at + n] = first + findLSB(bits);
                bits &= bits - 1u;
            }
        }
        block += gl_NumWorkGroups.x;
    }
    subgroupMemoryBarrierShared();
    subgroupBarrier();
    return count;
}

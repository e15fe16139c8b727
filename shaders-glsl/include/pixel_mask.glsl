// Selected pixels of a tile: a bit mask over the view, and the tile's own list of them.
//
// Features are wide and their maps are coarse or masked, so lanes work on the list of selected pixels. Needs constants
// SUBGROUP, TILE_WIDTH (at most 32) and TILE_HEIGHT, and the buffer `pixel_mask` of words.

shared uint listed[TILE_WIDTH * TILE_HEIGHT]; // column and row in the view, 16 bits each

const uint LANE_ROWS = (TILE_HEIGHT + SUBGROUP - 1u) / SUBGROUP; // of the tile, a lane

// A row's pixels as bits, the first the lowest.
uint mask_row(uint row, uvec2 corner, uvec2 size) {
    uint y = corner.y + row;
    if (row >= TILE_HEIGHT || y >= size.y) return 0u;
    uint columns = min(TILE_WIDTH, size.x - corner.x);
    uint bit = y * size.x + corner.x, shift = bit % 32u;
    uint bits = pixel_mask[bit / 32u] >> shift;
    // A row may end in the next word.
    if (shift + columns > 32u) bits |= pixel_mask[bit / 32u + 1u] << (32u - shift);
    return columns < 32u ? bits & ((1u << columns) - 1u) : bits;
}

// Fills the list; returns its length. Nothing is listed if the length is at most `least`. One subgroup is the workgroup.
uint list_marked_pixels(uvec2 corner, uvec2 size, uint least) {
    uint bits[LANE_ROWS];
    uint mine = 0u;
    [[unroll]] for (uint r = 0u; r < LANE_ROWS; ++r) {
        bits[r] = mask_row(r * SUBGROUP + gl_SubgroupInvocationID, corner, size);
        mine += bitCount(bits[r]);
    }
    uint count = subgroupAdd(mine);
    if (count <= least) return count;
    uint to = subgroupExclusiveAdd(mine);
    [[unroll]] for (uint r = 0u; r < LANE_ROWS; ++r) {
        uint y = corner.y + r * SUBGROUP + gl_SubgroupInvocationID;
        while (bits[r] != 0u) {
            listed[to++] = corner.x + findLSB(bits[r]) | y << 16;
            bits[r] &= bits[r] - 1u;
        }
    }
    subgroupMemoryBarrierShared();
    subgroupBarrier();
    return count;
}

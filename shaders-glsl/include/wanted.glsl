// Which pixels of a tile somebody wants features at: a bit a pixel of the view, and the tile's own list of them.
//
// Features are wide and their maps are coarse, or masked: a list of the wanted pixels, lanes side by side on it, costs
// what it must and no more. Needs constants SUBGROUP, TILE_WIDTH and TILE_HEIGHT, and the buffer `wanted` of words.

shared uint listed[TILE_WIDTH * TILE_HEIGHT]; // column and row in the view, 16 bits each

// Fills the list, in rows; returns its length. One subgroup is the workgroup.
uint list_wanted(uvec2 corner, uvec2 size) {
    uint count = 0u;
    for (uint from = 0u; from < TILE_WIDTH * TILE_HEIGHT; from += SUBGROUP) {
        uint item = from + gl_SubgroupInvocationID;
        uvec2 pixel = corner + uvec2(item % TILE_WIDTH, item / TILE_WIDTH);
        bool wants = item < TILE_WIDTH * TILE_HEIGHT && all(lessThan(pixel, size));
        if (wants) {
            uint bit = pixel.y * size.x + pixel.x;
            wants = (wanted[bit / 32u] >> (bit % 32u) & 1u) != 0u;
        }
        uvec4 votes = subgroupBallot(wants);
        if (wants) listed[count + subgroupBallotExclusiveBitCount(votes)] = pixel.x | pixel.y << 16;
        count += subgroupBallotBitCount(votes);
    }
    subgroupMemoryBarrierShared();
    subgroupBarrier();
    return count;
}

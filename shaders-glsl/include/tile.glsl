// Mapping of one subgroup to one tile, or to a part of it: PER_LANE slots of SUBGROUP pixels, in each of them one pixel a
// lane.
//
// A workgroup is one subgroup, so lanes share splats by broadcast: no shared memory and no barrier. Where HAS_PARTS is
// defined, several subgroups cover a tile (parts.glsl); elsewhere the part is the tile. Needs
// PART_WIDTH * PART_HEIGHT = SUBGROUP * PER_LANE, SUBGROUP a multiple of SLOT_WIDTH, and PART_WIDTH, too.
//
// With SUB_TILES a splat is tried only in the slots that it can touch (sub_tiles.glsl). The more a slot is like a square, the
// fewer these are.

layout(constant_id = 29) const bool SUB_TILES = true;
layout(constant_id = 31) const uint SLOT_WIDTH = 8;

#ifdef HAS_PARTS
#include "parts.glsl"
#else
const uint PART_WIDTH = TILE_WIDTH;
const uint PART_HEIGHT = TILE_HEIGHT;
const uint TILE_PARTS = 1u;
uvec2 part_corner(uint part) { return uvec2(0u); }
#endif

const uint SLOT_HEIGHT = SUBGROUP / SLOT_WIDTH;
const uint SLOTS_ACROSS = PART_WIDTH / SLOT_WIDTH;

struct Tile {
    uint index;
    uint part;
    uvec2 corner; // first pixel of the part
    uvec2 first;  // pixel of this lane in the first slot
};

// The first pixel of a slot, from the part's corner.
uvec2 slot_corner(uint k) { return uvec2(k % SLOTS_ACROSS * SLOT_WIDTH, k / SLOTS_ACROSS * SLOT_HEIGHT); }

// The pixel of a lane in a slot.
uvec2 pixel_of_lane(uint lane) { return uvec2(lane % SLOT_WIDTH, lane / SLOT_WIDTH); }

Tile this_tile(Camera camera) {
    uint index = folded_workgroup() / TILE_PARTS, part = folded_workgroup() % TILE_PARTS;
    uvec2 corner = uvec2(index % camera.tiles.x, index / camera.tiles.x) * uvec2(TILE_WIDTH, TILE_HEIGHT);
    corner += part_corner(part);
    return Tile(index, part, corner, corner + pixel_of_lane(gl_SubgroupInvocationID));
}

// Mapping of one subgroup to one tile: lanes along x (and as many rows as fit), PER_LANE rows of pixels below one another.
//
// A workgroup is one subgroup, so lanes share splats by broadcast: no shared memory and no barrier. Needs
// TILE_WIDTH * TILE_HEIGHT = SUBGROUP * PER_LANE and SUBGROUP a multiple of TILE_WIDTH.

struct Tile {
    uint index;
    uvec2 first; // pixel of this lane in the first row
    uint step_y; // rows between a lane's pixels
};

Tile this_tile(Camera camera, uint width, uint height, uint subgroup) {
    uint index = folded_workgroup();
    uvec2 tile = uvec2(index % camera.tiles.x, index / camera.tiles.x);
    uint lane = gl_SubgroupInvocationID;
    return Tile(index, tile * uvec2(width, height) + uvec2(lane % width, lane / width), subgroup / width);
}

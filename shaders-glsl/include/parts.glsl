// Parts of a tile: rectangles of its pixels, counted by rows. A subgroup of the forward pass of blending has one part, so that
// a view of few tiles still occupies a device. Needs TILE_WIDTH and TILE_HEIGHT, multiples of the sides of a part.

layout(constant_id = 33) const uint PART_WIDTH = 16;
layout(constant_id = 34) const uint PART_HEIGHT = 16;

const uint PARTS_ACROSS = TILE_WIDTH / PART_WIDTH;
const uint TILE_PARTS = PARTS_ACROSS * (TILE_HEIGHT / PART_HEIGHT);

// The first pixel of a part, from the tile's corner.
uvec2 part_corner(uint part) { return uvec2(part % PARTS_ACROSS * PART_WIDTH, part / PARTS_ACROSS * PART_HEIGHT); }

// The part of a pixel of the tile.
uint part_of_pixel(uvec2 pixel) { return pixel.y / PART_HEIGHT * PARTS_ACROSS + pixel.x / PART_WIDTH; }

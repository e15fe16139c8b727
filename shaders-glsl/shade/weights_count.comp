// Number of contributing splats of every pixel: the lengths of the rows that `weights` fills.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 8;
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(local_size_x_id = 0) in;
#include "tile.glsl"
#include "sub_tiles.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
OUT(uint, counts); // zero at first

uint visible[PER_LANE];
#define START(k, pixel) visible[k] = 0u;
#define VISIT(k, pixel, v, w) ++visible[k];
#define FINISH(k, pixel) counts[pixel] = visible[k];
#include "blend_visit.glsl"

void main() { visit_blend(); }

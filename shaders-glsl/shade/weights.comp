// Blending weights of a view as rows of a sparse matrix: for every pixel the contributing Gaussians, nearest first, with
// their weights over the pixel's opacity. Rows beyond the capacity are not written.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 8;
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(constant_id = 30) const uint WEIGHT_BITS = 32;
layout(local_size_x_id = 0) in;
#include "tile.glsl"
#include "sub_tiles.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
IN(uint, splat_ids);
IN(uint, row_starts); // [pixels + 1]
IN(float, coverage);
OUT(uint, columns);   // Gaussians
OUT(uint, weights);   // floats, or with WEIGHT_BITS 16 parts of 65535
OUT(uint, pixels);    // of each entry

uint next_entry[PER_LANE];
float inverse[PER_LANE];
float carried[PER_LANE];

// Rounds the weights of a row to units of 1/65535 in sequence and carries the rounding error to the next weight. A row keeps
// its sum to half a unit, however long it is, and each weight is off by at most one unit.
uint quantized(uint k, float weight) {
    if (WEIGHT_BITS != 16u) return floatBitsToUint(weight);
    precise float exact = weight * 65535.0 + carried[k];
    precise float units = clamp(roundEven(exact), 0.0, 65535.0);
    carried[k] = exact - units;
    return uint(units);
}

#define START(k, pixel)                 \
    next_entry[k] = row_starts[pixel];  \
    carried[k] = 0.0;                   \
    inverse[k] = inverse_coverage(coverage[pixel]);
#define VISIT(k, pixel, v, w)                   \
    if (next_entry[k] < columns.length()) {     \
        columns[next_entry[k]] = splat_ids[v];  \
        weights[next_entry[k]] = quantized(k, w * inverse[k]); \
        pixels[next_entry[k]] = pixel;          \
    }                                           \
    ++next_entry[k];
#define FINISH(k, pixel)
#include "blend_visit.glsl"

void main() { visit_blend(); }

// Gradient magnitudes of the differences on all levels, their sums, and their derivatives by the values of a level.
//
// One workgroup processes one tile of one level. It loads differences and masks with a margin of two pixels. Derivative
// filters run with a margin of one pixel, then the transposed filters of the magnitude's derivative. Derivatives are
// divided by the sum of the tent's weights, so that msg_bwd needs no such sums. They are not divided by the number of
// valid pixels, which msg_sum computes later.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "msg.glsl"

layout(constant_id = 0) const uint WORKGROUP = 96;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILE_X = 28; // 32 columns with both margins
layout(constant_id = 3) const uint TILE_Y = 16;
layout(constant_id = 4) const uint RUN = 6;        // rows of one invocation
layout(constant_id = 5) const bool SQUARE = false; // whether to sum squared differences in place of roughness
layout(constant_id = 6) const bool REUSE = false;  // see tile_filters.glsl

// Three-tap derivative filter of Farid and Simoncelli.
const float SIDE = 0.229879, MIDDLE = 0.540242, SCALE = 0.425287;
const bool REFLECT = true;
const bool TILE_XYZ = true, TILE_W = true;
const float FLOOR = 1e-8;

#define SUM_T vec4
#include "group_sum.glsl"
#include "tile_filters.glsl"

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec4, levels);
IN(uint, present);
OUT(vec4, slopes); // of all levels
OUT(vec4, sums);   // by workgroup: sum of magnitudes of albedo, number of valid pixels, the same for roughness

uint bits_row(uint at) { return tile_word(at) & tile_word(at + 1u) & tile_word(at + 2u); }

ivec2 tile_origin, tile_last; // first pixel of the tile, last one of the level
vec4 tile_sum = vec4(0.0);

struct March {
    TileRow above, here;
    uint bits_above, bits_here;
};

March march_begin(uint at) {
    return March(tile_row(at), tile_row(at + DATA_X), bits_row(at), bits_row(at + DATA_X));
}

void march_next(inout March m, uint column, uint row, out vec4 slope_x, out vec4 slope_y) {
    TileRow below = tile_row((row + 2u) * DATA_X + column);
    uint bits_below = bits_row((row + 2u) * DATA_X + column);
    int x = tile_origin.x + int(column) - 1, y = tile_origin.y + int(row) - 1;
    vec4 dx = tile_along_x(m.above, m.here, below), dy = tile_along_y(m.above, below);
    vec4 magnitude = sqrt(dx * dx + dy * dy + FLOOR);
    // A pixel is valid if its whole neighborhood is. Mirrored pixels belong to the neighborhood anyway.
    uint all_around = m.bits_above & m.bits_here & bits_below;
    bool inside = x >= 0 && y >= 0 && x <= tile_last.x && y <= tile_last.y;
    vec2 counts = inside ? vec2(all_around & HAS_ALBEDO, (all_around & HAS_ROUGHNESS) >> 1) : vec2(0.0);
    slope_x = counts.xxxy * dx / magnitude;
    slope_y = counts.xxxy * dy / magnitude;
    if (column - 1u < TILE_X && row - 1u < TILE_Y) {
        tile_sum.xy += counts.x * vec2((magnitude.r + magnitude.g + magnitude.b) / 3.0, 1.0);
        if (!SQUARE) tile_sum.zw += counts.y * vec2(magnitude.w, 1.0);
    }
    m.above = m.here;
    m.here = below;
    m.bits_above = m.bits_here;
    m.bits_here = bits_below;
}

#include "tile_slopes.glsl"

void main() {
    uvec2 full = params.step.camera.size;
    uint group = folded_workgroup(), tile = group, level = 0u;
    uvec2 tiles = uvec2(0u);
    [[unroll]] for (uint k = 0u; k < LEVELS; k++) {
        uvec2 t = level_tiles(full, k, uvec2(TILE_X, TILE_Y));
        bool beyond = level == k && tile >= t.x * t.y;
        if (level == k) tiles = t;
        tile -= beyond ? t.x * t.y : 0u;
        level += beyond ? 1u : 0u;
    }
    if (level >= LEVELS) {
        // The tile lies outside: the view is smaller than the largest, or the folded grid has excess workgroups.
        if (gl_LocalInvocationID.x == 0u && group < sums.length()) sums[group] = vec4(0.0);
        return;
    }
    uvec2 size = level_size(full, level);
    uint base = level_first(full, level);
    ivec2 origin = ivec2(uvec2(tile % tiles.x, tile / tiles.x) * uvec2(TILE_X, TILE_Y));
    ivec2 last = ivec2(size) - 1;
    tile_origin = origin;
    tile_last = last;

    for (uint item = gl_LocalInvocationID.x; item < DATA_X * DATA_Y; item += WORKGROUP) {
        ivec2 at = ivec2(item % DATA_X, item / DATA_X);
        ivec2 p = origin - 2 + at;
        uint pixel = base + uint(tile_inside(p.y, last.y)) * size.x + uint(tile_inside(p.x, last.x));
        vec4 d = levels[pixel];
        uint b = present[pixel];
        set_tile_data(item, d, b);
        if (SQUARE) {
            bool mine = at.x >= 2 && at.y >= 2 && at.x < int(TILE_X) + 2 && at.y < int(TILE_Y) + 2;
            bool inside = p.x <= last.x && p.y <= last.y;
            if (level == 0u && mine && inside && (b & HAS_ALBEDO) != 0u) tile_sum.zw += vec2(dot(d.rgb, d.rgb), 1.0);
        }
    }
    barrier();

    tile_slopes();

    vec2 scale = level_scale(full, level);
    for (uint item = gl_LocalInvocationID.x; item < TILE_X * ((TILE_Y + RUN - 1u) / RUN); item += WORKGROUP) {
        uint column = item % TILE_X, first = item / TILE_X * RUN, end = min(first + RUN, TILE_Y);
        int x = origin.x + int(column);
        if (x > last.x) continue;
        float total_x = tent_total(tent_of(uint(x), scale.x, full.x));
        TileTaps taps_x = tile_taps(x, last.x);
        TileRow above = tile_transposed_row(first * SLOPE_X + column, taps_x);
        TileRow here = tile_transposed_row((first + 1u) * SLOPE_X + column, taps_x);
        for (uint row = first; row < end; row++) {
            int y = origin.y + int(row);
            if (y > last.y) break;
            TileRow below = tile_transposed_row((row + 2u) * SLOPE_X + column, taps_x);
            float total = total_x * tent_total(tent_of(uint(y), scale.y, full.y));
            vec4 g = tile_transposed(above, here, below, tile_taps(y, last.y));
            slopes[base + uint(y) * size.x + uint(x)] = g / total;
            above = here;
            here = below;
        }
    }
    vec4 total = group_sum(tile_sum);
    if (gl_LocalInvocationID.x == 0u) sums[group] = total;
}

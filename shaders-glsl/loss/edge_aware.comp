// Edge-aware smoothness of albedo and roughness, and its gradients.
//
// One workgroup processes one tile. It loads materials and the photograph with a margin of two pixels. Sobel filters
// run with a margin of one pixel, then the transposed filters of the weighted signs. Borders repeat the last pixel.
// A response with an invalid pixel of the photograph, alpha 0, does not count.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "material_weights.glsl"

layout(constant_id = 0) const uint WORKGROUP = 96;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILE_X = 28; // 32 columns with both margins
layout(constant_id = 3) const uint TILE_Y = 16;
layout(constant_id = 4) const uint RUN = 6;     // rows of one invocation
layout(constant_id = 5) const bool ROUGHNESS = true;
layout(constant_id = 6) const bool REUSE = false; // see tile_filters.glsl

const float SIDE = 1.0, MIDDLE = 2.0, SCALE = 0.125;
const bool REFLECT = false;
const bool TILE_XYZ = true, TILE_W = true;

#define SUM_T vec2
#include "group_sum.glsl"
#include "tile_filters.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
layout(scalar) uniform WeightsBlock { MaterialWeights weights; } loss_weights;

IN(vec3, albedo_srgb);           // P
IN(vec3, roughness_gray);        // P, only the first channel is read
IN(uint, targets);               // packed RGBA8
INOUT(vec3, albedo_gradient);    // P, added to
INOUT(vec3, roughness_gradient); // P, added to the first channel
OUT(vec2, sums);                 // by workgroup: sum of albedo over pixels and channels, of roughness over pixels

struct PhotoRow {
    vec3 difference, smoothed;
    uint least; // smallest word: its alpha is 0 if a pixel of the row is invalid
};

PhotoRow photo_row(uint at) {
    uint u = tile_word(at), v = tile_word(at + 1u), w = tile_word(at + 2u);
    vec3 a = unpackUnorm4x8(u).rgb, b = unpackUnorm4x8(v).rgb, c = unpackUnorm4x8(w).rgb;
    return PhotoRow(c - a, a + 2.0 * b + c, min(u, min(v, w)));
}

// Edge factors of the three channels of albedo and of roughness. That of roughness is the mean of the others.
vec4 edge(vec3 filtered) {
    vec3 e = exp(-abs(filtered));
    return vec4(e, (e.r + e.g + e.b) / 3.0);
}

ivec2 tile_origin, tile_last; // first pixel of the tile, last one of the view
vec4 tile_sum = vec4(0.0);

struct March {
    TileRow above, here;
    PhotoRow photo_above, photo_here;
};

March march_begin(uint at) {
    return March(tile_row(at), tile_row(at + DATA_X), photo_row(at), photo_row(at + DATA_X));
}

void march_next(inout March m, uint column, uint row, out vec4 slope_x, out vec4 slope_y) {
    TileRow below = tile_row((row + 2u) * DATA_X + column);
    PhotoRow photo_below = photo_row((row + 2u) * DATA_X + column);
    int x = tile_origin.x + int(column) - 1, y = tile_origin.y + int(row) - 1;
    vec4 dx = tile_along_x(m.above, m.here, below), dy = tile_along_y(m.above, below);
    vec4 edge_x = edge(0.125 * (m.photo_above.difference + 2.0 * m.photo_here.difference + photo_below.difference));
    vec4 edge_y = edge(0.125 * (photo_below.smoothed - m.photo_above.smoothed));
    bool valid = min(m.photo_above.least, min(m.photo_here.least, photo_below.least)) >> 24 != 0u;
    bool counts = valid && x >= 0 && y >= 0 && x <= tile_last.x && y <= tile_last.y;
    slope_x = counts ? edge_x * sign(dx) : vec4(0.0);
    slope_y = counts ? edge_y * sign(dy) : vec4(0.0);
    bool mine = column - 1u < TILE_X && row - 1u < TILE_Y;
    if (counts && mine) tile_sum += edge_x * abs(dx) + edge_y * abs(dy);
    m.above = m.here;
    m.here = below;
    m.photo_above = m.photo_here;
    m.photo_here = photo_below;
}

#include "tile_slopes.glsl"

void main() {
    uvec2 size = params.step.camera.size;
    uint tiles_x = (size.x + TILE_X - 1u) / TILE_X;
    uint tiles_y = (size.y + TILE_Y - 1u) / TILE_Y;
    uint tile = folded_workgroup();
    if (tile >= tiles_x * tiles_y) {
        // The tile lies outside: the view is smaller than the largest, or the folded grid has excess workgroups.
        if (gl_LocalInvocationID.x == 0u && tile < sums.length()) sums[tile] = vec2(0.0);
        return;
    }
    ivec2 origin = ivec2(uvec2(tile % tiles_x, tile / tiles_x) * uvec2(TILE_X, TILE_Y));
    ivec2 last = ivec2(size) - 1;
    tile_origin = origin;
    tile_last = last;

    for (uint item = gl_LocalInvocationID.x; item < DATA_X * DATA_Y; item += WORKGROUP) {
        ivec2 p = origin - 2 + ivec2(item % DATA_X, item / DATA_X);
        uint pixel = uint(tile_inside(p.y, last.y)) * size.x + uint(tile_inside(p.x, last.x));
        vec4 material = vec4(albedo_srgb[pixel], ROUGHNESS ? roughness_gray[pixel].x : 0.0);
        set_tile_data(item, material, targets[params.step.target_offset + pixel]);
    }
    barrier();

    tile_slopes();

    float pixels = float(size.x) * float(size.y);
    vec2 weight = vec2(loss_weights.weights.albedo_edge / 3.0, loss_weights.weights.roughness_edge) / pixels;
    for (uint item = gl_LocalInvocationID.x; item < TILE_X * ((TILE_Y + RUN - 1u) / RUN); item += WORKGROUP) {
        uint column = item % TILE_X, first = item / TILE_X * RUN, end = min(first + RUN, TILE_Y);
        int x = origin.x + int(column);
        if (x > last.x) continue;
        TileTaps taps_x = tile_taps(x, last.x);
        TileRow above = tile_transposed_row(first * SLOPE_X + column, taps_x);
        TileRow here = tile_transposed_row((first + 1u) * SLOPE_X + column, taps_x);
        for (uint row = first; row < end; row++) {
            int y = origin.y + int(row);
            if (y > last.y) break;
            TileRow below = tile_transposed_row((row + 2u) * SLOPE_X + column, taps_x);
            vec4 g = tile_transposed(above, here, below, tile_taps(y, last.y));
            uint pixel = uint(y) * size.x + uint(x);
            albedo_gradient[pixel] += weight.x * g.rgb;
            if (ROUGHNESS) roughness_gradient[pixel].x += weight.y * g.w;
            above = here;
            here = below;
        }
    }
    vec2 total = group_sum(vec2(tile_sum.x + tile_sum.y + tile_sum.z, tile_sum.w));
    if (gl_LocalInvocationID.x == 0u) sums[tile] = total;
}

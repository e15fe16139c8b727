// Losses of blended normals and depths, with their gradients.
//
// Terms: agreement with prior normals and prior depths, edge-aware smoothness of unit normals and of depth, spread of
// depth along the ray. Invalid pixels of the photograph, alpha 0, have no terms and no gradient.
//
// One workgroup processes one tile. It loads unit normals, depths and the photograph with a margin of two pixels. Sobel
// filters run with a margin of one pixel and march down columns, so that each value is loaded once for three rows. The
// transposed filters of the weighted signs march in the same way. The chain rule then gives gradients of the blended
// values. Borders repeat the last pixel, as in the published code. In the transposed filters, that changes the middle
// tap at the border.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "distortion.glsl"
#include "octahedral.glsl"

layout(constant_id = 0) const uint WORKGROUP = 96;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILE_X = 28;   // 32 columns with both margins
layout(constant_id = 3) const uint TILE_Y = 16;
layout(constant_id = 4) const uint RUN = 6;       // rows of one invocation
layout(constant_id = 5) const uint CHANNELS = 8;  // floats of a pixel of the image
layout(constant_id = 6) const uint NORMALS = 1;   // 1 if normals were blended
layout(constant_id = 7) const uint NORMAL_AT = 3; // first channel of normals
layout(constant_id = 8) const uint DEPTH = 1;     // 1 if depth was blended
layout(constant_id = 9) const uint DEPTH_AT = 6;  // channel of depth; squared depth is in the next
layout(constant_id = 10) const bool PRIOR = true; // whether there are prior normals
layout(constant_id = 11) const bool REUSE = false; // see tile_filters.glsl
layout(constant_id = 12) const bool DEPTH_PRIOR = false; // whether there are prior depths
layout(constant_id = 13) const bool DEPTH_FIT = false;   // whether a line leads from their values to inverse depths
layout(constant_id = 14) const bool SENSOR = false;      // whether they belong to the given lens, not to the learned one

// Sobel filters, without the factor of an eighth.
const float SIDE = 1.0, MIDDLE = 2.0, SCALE = 1.0;
const bool REFLECT = false;
const bool TILE_XYZ = NORMALS != 0u, TILE_W = DEPTH != 0u;

#define SUM_T vec4
#include "group_sum.glsl"
#include "tile_filters.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
layout(scalar) uniform GivenBlock { Step step; } given;

IN(float, image);
IN(float, transmittance);
IN(uint, targets);
IN(uint, priors);                // world space, octahedral
IN(uint, depth_priors);          // half floats: inverse depth, or a value to be fitted, and confidence
IN(float, depth_line);           // slope and offset of the fit; zero if there is none
OUT(float, grad_image);          // the channels of normals and depth are written
OUT(float, grad_transmittance);  // always written
// By workgroup: normal, normal smoothness, depth smoothness, depth variance. With prior depths, their losses follow
// those of all workgroups, in x.
OUT(vec4, sums);

// Smallest divisor. Normals and depths are divided by the length of the blended normal and by the opacity, but at least
// by this. Gradients thus stay below 1000 times those in the middle of a surface.
const float FLOOR = 1e-3;
const float VARIANCE_MIN = 1e-6;

vec3 blended_normal(uint pixel) {
    uint i = pixel * CHANNELS + NORMAL_AT;
    return vec3(image[i], image[i + 1u], image[i + 2u]);
}

// Contribution of one row to a Sobel filter: differences and weighted sums of three neighbors, times eight.
struct FilterRow {
    vec4 data_d, data_s;
    vec3 photo_d, photo_s;
    uint least; // smallest word of the photograph: its alpha is 0 if a neighbor is invalid
};

FilterRow filter_row(uint at) {
    vec4 a = tile_data(at), b = tile_data(at + 1u), c = tile_data(at + 2u);
    uint u = tile_word(at), v = tile_word(at + 1u), w = tile_word(at + 2u);
    vec3 p = unpackUnorm4x8(u).rgb, q = unpackUnorm4x8(v).rgb, r = unpackUnorm4x8(w).rgb;
    return FilterRow(c - a, a + 2.0 * b + c, r - p, p + 2.0 * q + r, min(u, min(v, w)));
}

// Contribution of one row to the transposed filters. `low` and `high` are 1 at the first and last column.
struct Signs {
    vec4 d, s;
};

Signs transposed_row(uint at, float low, float high) {
    Signs r = Signs(vec4(0.0), vec4(0.0));
    float middle_d = high - low, middle_s = 2.0 + low + high;
    if (NORMALS != 0u) {
        r.d.xyz = tile_x(at).xyz + middle_d * tile_x(at + 1u).xyz - tile_x(at + 2u).xyz;
        r.s.xyz = tile_y(at).xyz + middle_s * tile_y(at + 1u).xyz + tile_y(at + 2u).xyz;
    }
    if (DEPTH != 0u) {
        r.d.w = tile_x_w(at) + middle_d * tile_x_w(at + 1u) - tile_x_w(at + 2u);
        r.s.w = tile_y_w(at) + middle_s * tile_y_w(at + 1u) + tile_y_w(at + 2u);
    }
    return r;
}

ivec2 tile_origin, tile_last; // first pixel of the tile, last one of the view
vec4 tile_sum = vec4(0.0);
float depth_sum = 0.0;

// Prior depth at a pixel. A sensor measures along the rays of the given lens.
vec2 depth_prior(uint pixel) {
    if (SENSOR) {
        Camera camera = params.step.camera, sensor = given.step.camera;
        vec2 center = vec2(pixel % camera.size.x, pixel / camera.size.x) + 0.5;
        vec2 at = floor(pixel_slope(camera, center) * sensor.focal + sensor.center);
        if (any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, vec2(camera.size)))) return vec2(0.0);
        pixel = uint(at.y) * camera.size.x + uint(at.x);
    }
    return unpackHalf2x16(depth_priors[params.step.target_offset + pixel]);
}

struct March {
    FilterRow above, here;
};

March march_begin(uint at) { return March(filter_row(at), filter_row(at + DATA_X)); }

// Slopes are derivatives of the loss by the filtered values, before mean and weight.
void march_next(inout March m, uint column, uint row, out vec4 slope_x, out vec4 slope_y) {
    FilterRow below = filter_row((row + 2u) * DATA_X + column);
    int x = tile_origin.x + int(column) - 1, y = tile_origin.y + int(row) - 1;
    vec4 dx = 0.125 * (m.above.data_d + 2.0 * m.here.data_d + below.data_d);
    vec4 dy = 0.125 * (below.data_s - m.above.data_s);
    vec3 edge_x = exp(-0.125 * abs(m.above.photo_d + 2.0 * m.here.photo_d + below.photo_d));
    vec3 edge_y = exp(-0.125 * abs(below.photo_s - m.above.photo_s));
    vec2 edge = vec2(edge_x.r + edge_x.g + edge_x.b, edge_y.r + edge_y.g + edge_y.b) / 3.0;
    bool valid = min(m.above.least, min(m.here.least, below.least)) >> 24 != 0u;
    if (!valid || x < 0 || y < 0 || x > tile_last.x || y > tile_last.y) {
        dx = vec4(0.0);
        dy = vec4(0.0);
    }
    slope_x = vec4(edge_x, edge.x) * sign(dx);
    slope_y = vec4(edge_y, edge.y) * sign(dy);
    if (column - 1u < TILE_X && row - 1u < TILE_Y) {
        tile_sum.y += dot(edge_x, abs(dx.xyz)) + dot(edge_y, abs(dy.xyz));
        tile_sum.z += dot(edge, abs(vec2(dx.w, dy.w)));
    }
    m.above = m.here;
    m.here = below;
}

#include "tile_slopes.glsl"

// Applies the chain rule at one pixel. `smoothness` is the derivative by the unit normal and the depth.
void finish(uint pixel, vec4 smoothness, float mean) {
    Step s = params.step;
    if (NORMALS != 0u) {
        vec3 blended = blended_normal(pixel);
        float size = length(blended);
        vec3 unit = blended / max(size, FLOOR);
        vec3 g = smoothness.xyz;
        if (PRIOR) {
            uint packed = priors[s.target_offset + pixel];
            if (octahedral_present(packed)) {
                vec3 prior = octahedral_decode(packed);
                tile_sum.x += 1.0 - dot(unit, prior);
                g -= s.weight_normal * mean * prior;
            }
        }
        g = (size > FLOOR ? g - unit * dot(unit, g) : g) / max(size, FLOOR);
        uint i = pixel * CHANNELS + NORMAL_AT;
        grad_image[i] = g.x;
        grad_image[i + 1u] = g.y;
        grad_image[i + 2u] = g.z;
    }
    float by_transmittance = 0.0;
    if (DEPTH != 0u) {
        float alpha = 1.0 - transmittance[pixel];
        float inverse = 1.0 / max(alpha, FLOOR);
        uint i = pixel * CHANNELS + DEPTH_AT;
        float depth = image[i] * inverse, square = image[i + 1u] * inverse;
        float variance = square - depth * depth;
        float deviation = sqrt(max(variance, VARIANCE_MIN));
        tile_sum.w += deviation;
        float by_variance = variance > VARIANCE_MIN ? 0.5 * s.weight_depth_variance * mean / deviation : 0.0;
        float by_depth = smoothness.w - 2.0 * depth * by_variance;
        if (DEPTH_PRIOR) {
            vec2 prior = depth_prior(pixel);
            if (DEPTH_FIT) prior.x = depth_line[0] * prior.x + depth_line[1];
            if (prior.x > 0.0) {
                float error = depth * prior.x - 1.0;
                depth_sum += prior.y * abs(error);
                by_depth += s.weight_depth * mean * prior.y * prior.x * sign(error);
            }
        }
        grad_image[i] = by_depth * inverse;
        grad_image[i + 1u] = by_variance * inverse;
        // The derivative by opacity is -(by_depth depth + by_variance square) / opacity; opacity is 1 - transmittance.
        if (alpha > FLOOR) by_transmittance = (by_depth * depth + by_variance * square) * inverse;
    }
    grad_transmittance[pixel] = by_transmittance;
}

// Clears the gradients of an invalid pixel, whose blended values may be non-finite.
void clear(uint pixel) {
    uint i = pixel * CHANNELS;
    if (NORMALS != 0u) {
        for (uint c = 0u; c < 3u; c++) grad_image[i + NORMAL_AT + c] = 0.0;
    }
    if (DEPTH != 0u) {
        for (uint c = 0u; c < 2u; c++) grad_image[i + DEPTH_AT + c] = 0.0;
    }
    grad_transmittance[pixel] = 0.0;
}

void main() {
    uvec2 size = params.step.camera.size;
    uint tiles_x = (size.x + TILE_X - 1u) / TILE_X;
    uint tiles_y = (size.y + TILE_Y - 1u) / TILE_Y;
    uint tile = folded_workgroup();
    uint most = DEPTH_PRIOR ? uint(sums.length()) / 2u : uint(sums.length());
    if (tile >= tiles_x * tiles_y) {
        // The tile lies outside: the view is smaller than the largest, or the folded grid has excess workgroups.
        if (gl_LocalInvocationID.x == 0u && tile < most) {
            sums[tile] = vec4(0.0);
            if (DEPTH_PRIOR) sums[most + tile] = vec4(0.0);
        }
        return;
    }
    ivec2 origin = ivec2(uvec2(tile % tiles_x, tile / tiles_x) * uvec2(TILE_X, TILE_Y));
    ivec2 last = ivec2(size) - 1;
    tile_origin = origin;
    tile_last = last;

    for (uint item = gl_LocalInvocationID.x; item < DATA_X * DATA_Y; item += WORKGROUP) {
        ivec2 p = clamp(origin - 2 + ivec2(item % DATA_X, item / DATA_X), ivec2(0), last);
        uint pixel = uint(p.y) * size.x + uint(p.x);
        vec4 v = vec4(0.0);
        if (NORMALS != 0u) {
            v.xyz = blended_normal(pixel);
            v.xyz /= max(length(v.xyz), FLOOR);
        }
        if (DEPTH != 0u) v.w = image[pixel * CHANNELS + DEPTH_AT] / max(1.0 - transmittance[pixel], FLOOR);
        set_tile_data(item, v, targets[params.step.target_offset + pixel]);
    }
    barrier();

    tile_slopes();

    float mean = 1.0 / (float(size.x) * float(size.y));
    vec4 weight = 0.125 * mean * vec4(vec3(params.step.weight_normal_smooth / 3.0), params.step.weight_depth_smooth);
    for (uint item = gl_LocalInvocationID.x; item < TILE_X * ((TILE_Y + RUN - 1u) / RUN); item += WORKGROUP) {
        uint column = item % TILE_X, first = item / TILE_X * RUN, end = min(first + RUN, TILE_Y);
        int x = origin.x + int(column);
        if (x > last.x) continue;
        float low = float(x == 0), high = float(x == last.x);
        Signs above = transposed_row(first * SLOPE_X + column, low, high);
        Signs here = transposed_row((first + 1u) * SLOPE_X + column, low, high);
        for (uint row = first; row < end; row++) {
            int y = origin.y + int(row);
            if (y > last.y) break;
            Signs below = transposed_row((row + 2u) * SLOPE_X + column, low, high);
            float top = float(y == 0), bottom = float(y == last.y);
            vec4 d = above.d + (2.0 + top + bottom) * here.d + below.d;
            vec4 s = above.s + (bottom - top) * here.s - below.s;
            uint pixel = uint(y) * size.x + uint(x);
            if (targets[params.step.target_offset + pixel] >> 24 != 0u) finish(pixel, weight * (d + s), mean);
            else clear(pixel);
            above = here;
            here = below;
        }
    }
    vec4 total = group_sum(tile_sum);
    if (gl_LocalInvocationID.x == 0u) sums[tile] = total;
    if (DEPTH_PRIOR) {
        barrier(); // before the shared sums are written again
        float of_depth = group_sum(vec4(depth_sum)).x;
        if (gl_LocalInvocationID.x == 0u) sums[most + tile] = vec4(of_depth, 0.0, 0.0, 0.0);
    }
}

// Backward of the visibility field, second half: from gradients of the points' rows to the first layer's weights of
// features, and to the tables' entries.
//
// Pixels share entries, so these are summed as integers, whose sum does not depend on order. A bit mask records the
// touched entries.
#version 460
#include "common.glsl"
#include "coverage.glsl"
#include "finite.glsl"
#include "visibility_grid.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint LEVELS = 16;
layout(constant_id = 3) const uint PARTS = 1; // of the lights, each with its rows

layout(push_constant, scalar) uniform Push {
    uint first; // pixel
    uint count;
} push;

layout(scalar) uniform FieldBlock { FieldStep field; } params;

IN(FieldLevel, field_levels);
#include "visibility_tables.glsl"
IN(float, mlp);
IN(vec3, points);
IN(float, coverage);
IN(float, row_gradients);     // PARTS x count x 32
IN(float, scale);             // of whole numbers, and its inverse
OUT(float, feature_sums);     // by workgroup and side: neuron, feature
INOUT(uint, table_gradients); // entries x 2 x 2
INOUT(uint, touched);         // a bit an entry

#define ITEM_COUNT 4
#include "visibility_lanes.glsl"
#define WHOLE_SUMS table_gradients
#include "whole_sum.glsl"

const uint FEATURES = 2u * LEVELS;
const uint INPUTS = FEATURES + 4u;

float features[WIDTH];          // of this lane's item, padded
float gradients[ITEMS * HELD];  // of rows, by item
float by_first[FEATURES * HELD];
float row_of[WIDTH * HELD];     // of the first layer, features side by side
float by_feature[ITEMS * HELD]; // by item; this lane's features are neuron(h)
float staged[ITEMS * HELD];

uint side_first;
bool lane_shaded;

float first_row(uint n, uint h) { return neuron(h) < FEATURES ? mlp[n * INPUTS + neuron(h)] : 0.0; }

void fetch_row(uint item) {
    bool is_shaded = from_lane(lane_shaded ? 1.0 : 0.0, item) > 0.0;
    uint at = min(side_first + item, push.count - 1u) * WIDTH;
    EACH_HELD(h) {
        float sum = is_shaded ? row_gradients[at + neuron(h)] : 0.0;
        [[unroll]] for (uint part = 1u; part < PARTS; part++) {
            sum += is_shaded ? row_gradients[part * push.count * WIDTH + at + neuron(h)] : 0.0;
        }
        // Parts are finite, but their sum may not be.
        if (PARTS > 1u && !finite_bits(sum)) sum = 0.0;
        gradients[item * HELD + h] = sum;
    }
}

void back(uint item) {
    float sum[HELD];
    EACH_HELD(h) sum[h] = 0.0;
    [[unroll]] for (uint n = 0u; n < WIDTH; n++) {
        float g = from_lane(gradients[item * HELD + n % HELD], n / HELD);
        EACH_HELD(h) sum[h] = fma(row_of[n * HELD + h], g, sum[h]);
    }
    EACH_HELD(h) by_feature[item * HELD + h] = sum[h];
}

void outer(uint item) {
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
        float x = from_lane(features[k], item);
        EACH_HELD(h) by_first[k * HELD + h] = fma(gradients[item * HELD + h], x, by_first[k * HELD + h]);
    }
}

void encode(vec3 position) {
    [[dont_unroll]] for (uint l = 0u; l < LEVELS; l++) {
        FieldLevel level = field_levels[l];
        FieldCell cell = field_cell(level, position);
        vec2 sum = vec2(0.0);
        [[unroll]] for (uint corner = 0u; corner < 8u; corner++) {
            float weight;
            uint entry = field_corner(level, cell, corner, weight);
            sum = fma(vec2(weight), table_entry(entry), sum);
        }
        features[2u * l] = sum.x;
        features[2u * l + 1u] = sum.y;
    }
}

// Not below only if the weights have become something that is no network.
float bounded(float g) { return abs(g) < 4e18 ? g : 0.0; }

// Features of a level that lie in one lane.
const uint TOGETHER = HELD > 1u ? 2u : 1u;

// This lane's features of an item, to the entries that they came from.
void scatter(uint item, vec3 position, float power) {
    [[dont_unroll]] for (uint h = 0u; h < HELD; h += TOGETHER) {
        uint feature = neuron(h);
        float one = bounded(staged[item * HELD + h] * power), two = 0.0;
        if (TOGETHER > 1u) two = bounded(staged[item * HELD + h + TOGETHER - 1u] * power);
        if (feature >= FEATURES || (one == 0.0 && two == 0.0)) continue;
        FieldLevel level = field_levels[feature / 2u];
        FieldCell cell = field_cell(level, position);
        [[dont_unroll]] for (uint corner = 0u; corner < 8u; corner++) {
            float weight;
            uint entry = field_corner(level, cell, corner, weight);
            add_whole(2u * entry + feature % 2u, weight * one);
            if (TOGETHER > 1u) add_whole(2u * entry + 1u, weight * two);
            uint bit = 1u << (entry % 32u);
            if ((touched[entry / 32u] & bit) == 0u) atomicOr(touched[entry / 32u], bit);
        }
    }
}

void main() {
    FILL_COLUMNS(row_of, WIDTH, first_row)
    [[unroll]] for (uint i = 0u; i < FEATURES * HELD; i++) by_first[i] = 0.0;
    uint side = gl_SubgroupInvocationID / ACROSS;
    float power = scale[0];
    [[dont_unroll]] for (uint batch = gl_WorkGroupID.x * SIDES; batch * ITEMS < push.count;
                         batch += gl_NumWorkGroups.x * SIDES) {
        side_first = (batch + side) * ITEMS;
        uint local = side_first + column() % ITEMS, pixel = push.first + local;
        bool exists = local < push.count && pixel < params.field.pixels;
        lane_shaded = exists && is_covered(coverage[exists ? pixel : 0u]);
        vec3 point = field_inside(params.field, lane_shaded ? points[pixel] : params.field.box_min);
        vec3 position = field_position(params.field, point);
        encode(position);
        EACH_ITEM(fetch_row)
        EACH_ITEM(outer)
        EACH_ITEM(back)
        [[unroll]] for (uint i = 0u; i < ITEMS * HELD; i++) staged[i] = by_feature[i];
        [[dont_unroll]] for (uint item = 0u; item < ITEMS; item++) {
            vec3 at = vec3(from_lane(position.x, item), from_lane(position.y, item), from_lane(position.z, item));
            scatter(item, at, power);
        }
    }
    float sums[FEATURES * HELD];
    [[unroll]] for (uint i = 0u; i < FEATURES * HELD; i++) sums[i] = by_first[i];
    uint to = (gl_WorkGroupID.x * SIDES + side) * WIDTH * FEATURES;
    [[dont_unroll]] for (uint i = 0u; i < FEATURES * HELD; i++) {
        feature_sums[to + neuron(i % HELD) * FEATURES + i / HELD] = sums[i];
    }
}

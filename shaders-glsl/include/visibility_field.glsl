// Visibility field, an invocation a pixel: visibility of a light from a point, in (0, 1).
//
// An MLP with layers of 2 LEVELS + 4, 32, 32, 1, without biases; ReLU, and a sigmoid at the end. The first layer is split:
// the point's contribution is computed once a pixel (`field_pixel`), direction and distance are added for each light.
//
// Call field_weights(), then field_pixel() for each pixel, then field_visibility() any number of times, all of them from
// uniform control flow, by every invocation. Needs SUBGROUP, WORKGROUP, LEVELS (at most 16), FIELD_SPREAD, and buffers
// `mlp` (rows of the first layer: features, direction, distance; rows of the second, the last), `field_levels`; the tables
// are visibility_tables.glsl's.
//
// With FIELD_SPREAD the eight lanes of a subgroup process their eight pixels together, lanes over neurons, because CPUs
// read weights cheaply only from an invocation's own arrays; see visibility_lanes.glsl. Without, every invocation works
// alone, with weights in shared memory. Where MATRIX_UNITS is defined, the subgroup multiplies the second layer together,
// with operands of 16 bits (visibility_matrices.glsl), and FIELD_SPREAD must not be set.

#include "visibility_lanes.glsl"

const uint FIELD_FEATURES = 2u * LEVELS;
const uint FIELD_INPUTS = FIELD_FEATURES + 4u;
const uint FIELD_SECOND = WIDTH * FIELD_INPUTS;
const uint FIELD_LAST = FIELD_SECOND + WIDTH * WIDTH;

#define FIELD_EACH(i, count) [[unroll]] for (uint i = 0u; i < count; i++)

float field_features[FIELD_FEATURES];

void field_encode(vec3 position) {
    [[dont_unroll]] for (uint l = 0u; l < LEVELS; l++) {
        FieldLevel level = field_levels[l];
        FieldCell cell = field_cell(level, position);
        vec2 sum = vec2(0.0);
        FIELD_EACH(corner, 8u) {
            float weight;
            uint entry = field_corner(level, cell, corner, weight);
            sum = fma(vec2(weight), table_entry(entry), sum);
        }
        field_features[2u * l] = sum.x;
        field_features[2u * l + 1u] = sum.y;
    }
}

// Neurons side by side.

float spread_first[FIELD_FEATURES * HELD]; // columns of the first layer
float spread_second[WIDTH * HELD];         // columns of the second layer
float spread_pair[4u * HELD];              // of the first layer: direction, distance
float spread_last[HELD];
float spread_points[ITEMS * HELD];         // the first layer's response to each item's point
float spread_logits[ITEMS];
vec4 spread_way;                           // of this lane's item: direction, distance

float first_column(uint k, uint h) { return mlp[neuron(h) * FIELD_INPUTS + k]; }
float second_column(uint k, uint h) { return mlp[FIELD_SECOND + neuron(h) * WIDTH + k]; }
float pair_column(uint k, uint h) { return mlp[neuron(h) * FIELD_INPUTS + FIELD_FEATURES + k]; }
float last_column(uint k, uint h) { return mlp[FIELD_LAST + neuron(h)]; }

void spread_project(uint item) {
    float sum[HELD];
    EACH_HELD(h) sum[h] = 0.0;
    FIELD_EACH(k, FIELD_FEATURES) {
        float x = from_lane(field_features[k], item);
        EACH_HELD(h) sum[h] = fma(spread_first[k * HELD + h], x, sum[h]);
    }
    EACH_HELD(h) spread_points[item * HELD + h] = sum[h];
}

void spread_layers(uint item) {
    float x = from_lane(spread_way.x, item), y = from_lane(spread_way.y, item), z = from_lane(spread_way.z, item);
    float reach = from_lane(spread_way.w, item);
    float hidden[HELD], sum[HELD];
    EACH_HELD(h) {
        float at = fma(spread_pair[3u * HELD + h], reach, spread_points[item * HELD + h]);
        at = fma(spread_pair[h], x, fma(spread_pair[HELD + h], y, fma(spread_pair[2u * HELD + h], z, at)));
        hidden[h] = rectified(at);
        sum[h] = 0.0;
    }
    FIELD_EACH(k, WIDTH) {
        float x = from_lane(hidden[k % HELD], k / HELD);
        EACH_HELD(h) sum[h] = fma(spread_second[k * HELD + h], x, sum[h]);
    }
    float logit = 0.0;
    EACH_HELD(h) logit = fma(spread_last[h], rectified(sum[h]), logit);
    spread_logits[item] = logit;
}

// Every invocation alone. Blocks are four neurons.

shared vec4 shared_first[8u * FIELD_FEATURES]; // by block, feature, neuron
#ifndef MATRIX_UNITS
shared vec4 shared_second[8u * WIDTH];         // by block, input, neuron
#endif
shared vec4 shared_pair[WIDTH];                // by neuron: direction, distance
shared float shared_last[WIDTH];
float alone_point[WIDTH]; // the first layer's response to this pixel's point
float alone_hidden[WIDTH];
float alone_logit;

#define FIELD_BLOCKS(f) f(0u); f(1u); f(2u); f(3u); f(4u); f(5u); f(6u); f(7u);

// Four rows' weights of one column.
vec4 rows_column(uint at, uint pitch) {
    return vec4(mlp[at], mlp[at + pitch], mlp[at + 2u * pitch], mlp[at + 3u * pitch]);
}

void alone_weights() {
    uint lane = gl_LocalInvocationID.x;
    [[dont_unroll]] for (uint i = lane; i < 8u * FIELD_FEATURES; i += WORKGROUP)
        shared_first[i] = rows_column(i / FIELD_FEATURES * 4u * FIELD_INPUTS + i % FIELD_FEATURES, FIELD_INPUTS);
#ifndef MATRIX_UNITS
    [[dont_unroll]] for (uint i = lane; i < 8u * WIDTH; i += WORKGROUP)
        shared_second[i] = rows_column(FIELD_SECOND + i / WIDTH * 4u * WIDTH + i % WIDTH, WIDTH);
#endif
    [[dont_unroll]] for (uint i = lane; i < WIDTH; i += WORKGROUP) {
        shared_pair[i] = rows_column(i * FIELD_INPUTS + FIELD_FEATURES, 1u);
        shared_last[i] = mlp[FIELD_LAST + i];
    }
    barrier();
}

void alone_project(uint block) {
    vec4 sum = vec4(0.0);
    FIELD_EACH(k, FIELD_FEATURES) sum = fma(shared_first[block * FIELD_FEATURES + k], vec4(field_features[k]), sum);
    FIELD_EACH(j, 4u) alone_point[block * 4u + j] = sum[j];
}

// A neuron of the first layer.
float alone_first(uint n, vec4 way) {
    vec4 w = shared_pair[n];
    return rectified(fma(w.x, way.x, fma(w.y, way.y, fma(w.z, way.z, fma(w.w, way.w, alone_point[n])))));
}

#ifdef MATRIX_UNITS
#include "visibility_matrices.glsl"
#else
void alone_second(uint block) {
    vec4 sum = vec4(0.0);
    FIELD_EACH(k, WIDTH) sum = fma(shared_second[block * WIDTH + k], vec4(alone_hidden[k]), sum);
    FIELD_EACH(j, 4u) alone_logit = fma(shared_last[block * 4u + j], rectified(sum[j]), alone_logit);
}

void alone_layers(vec4 way) {
    FIELD_EACH(n, WIDTH) alone_hidden[n] = alone_first(n, way);
    alone_logit = 0.0;
    FIELD_BLOCKS(alone_second)
}
#endif

// Either.

void field_weights() {
    if (FIELD_SPREAD) {
        FILL_COLUMNS(spread_first, FIELD_FEATURES, first_column)
        FILL_COLUMNS(spread_second, WIDTH, second_column)
        FILL_COLUMNS(spread_pair, 4u, pair_column)
        FILL_COLUMNS(spread_last, 1u, last_column)
    } else {
#ifdef MATRIX_UNITS
        matrices_weights();
#else
        alone_weights();
#endif
    }
}

// The first layer's share of the point, from its features.
void field_project() {
    if (FIELD_SPREAD) {
        EACH_ITEM(spread_project)
    } else {
        FIELD_BLOCKS(alone_project)
    }
}

// `position`: in the box's coordinates.
void field_pixel(vec3 position) {
    field_encode(position);
    field_project();
}

// Of the light that is field_way() away.
float field_visibility(vec4 way) {
    float logit;
    if (FIELD_SPREAD) {
        spread_way = way;
        EACH_ITEM(spread_layers)
        ITEM_SUMS(spread_logits)
        logit = spread_logits[0];
    } else {
#ifdef MATRIX_UNITS
        logit = matrices_logit(way);
#else
        alone_layers(way);
        logit = alone_logit;
#endif
    }
    return 1.0 / (1.0 + exp(-logit));
}

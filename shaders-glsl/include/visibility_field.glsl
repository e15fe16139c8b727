// Visibility field, an invocation a pixel: visibility of lights from a point, in (0, 1).
//
// An MLP with layers of 2 LEVELS + 4, 32, 32, 1, without biases; ReLU, and a sigmoid at the end. The first layer is split:
// the point's contribution is computed once a pixel (`field_pixel`), direction and distance are added for each light.
//
// Call field_weights(), then field_pixel() for each pixel, then field_visibilities() any number of times, all of them from
// uniform control flow, by every invocation. Needs SUBGROUP, WORKGROUP, LEVELS (at most 16), FIELD_SPREAD, and buffers
// `mlp` (rows of the first layer: features, direction, distance; rows of the second, the last), `field_levels`; the tables
// are visibility_tables.glsl's, and visibility_weights.glsl binds `mlp` a second time.
//
// With FIELD_SPREAD the eight lanes of a subgroup process their eight pixels together, lanes over neurons, because CPUs
// read weights cheaply only from an invocation's own arrays; see visibility_lanes.glsl. Without, every invocation works
// alone on FIELD_TOGETHER lights of its pixel at once, which share each weight (visibility_pairs.glsl). Where MATRIX_UNITS is
// defined, the subgroup multiplies the second layer together, with operands of 16 bits (visibility_matrices.glsl), and
// FIELD_SPREAD must not be set.

#include "visibility_lanes.glsl"

const uint FIELD_FEATURES = 2u * LEVELS;
const uint FIELD_INPUTS = FIELD_FEATURES + 4u;
const uint FIELD_SECOND = WIDTH * FIELD_INPUTS;
const uint FIELD_LAST = FIELD_SECOND + WIDTH * WIDTH;

// Lights of a pixel that are evaluated at once: as many as registers hold 32 sums of.
#ifdef MATRIX_UNITS
const uint FIELD_TOGETHER = 1u;
#else
const uint FIELD_TOGETHER = FIELD_SPREAD ? 1u : SUBGROUP > 32u ? 2u : 4u;
#endif

#define FIELD_EACH(i, count) [[unroll]] for (uint i = 0u; i < count; i++)

// Features of a level.
vec2 field_level(uint l, vec3 position) {
    FieldLevel level = field_levels[l];
    FieldCell cell = field_cell(level, position);
    vec2 sum = vec2(0.0);
    FIELD_EACH(corner, 8u) {
        float weight;
        uint entry = field_corner(level, cell, corner, weight);
        sum = fma(vec2(weight), table_entry(entry), sum);
    }
    return sum;
}

// Neurons side by side.

float field_features[FIELD_FEATURES];

void field_encode(vec3 position) {
    [[dont_unroll]] for (uint l = 0u; l < LEVELS; l++) {
        vec2 level = field_level(l, position);
        field_features[2u * l] = level.x;
        field_features[2u * l + 1u] = level.y;
    }
}

const uint SPREAD_TOGETHER = 2u;           // items that share loads of the second layer

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

// SPREAD_TOGETHER items from `first` on, which share each weight.
void spread_layers(uint first) {
    float hidden[SPREAD_TOGETHER * HELD], sum[SPREAD_TOGETHER * HELD];
    FIELD_EACH(i, SPREAD_TOGETHER) {
        uint item = first + i;
        float x = from_lane(spread_way.x, item), y = from_lane(spread_way.y, item), z = from_lane(spread_way.z, item);
        float reach = from_lane(spread_way.w, item);
        EACH_HELD(h) {
            float at = fma(spread_pair[3u * HELD + h], reach, spread_points[item * HELD + h]);
            at = fma(spread_pair[h], x, fma(spread_pair[HELD + h], y, fma(spread_pair[2u * HELD + h], z, at)));
            hidden[i * HELD + h] = rectified(at);
            sum[i * HELD + h] = 0.0;
        }
    }
    FIELD_EACH(k, WIDTH) {
        float x[SPREAD_TOGETHER];
        FIELD_EACH(i, SPREAD_TOGETHER) x[i] = from_lane(hidden[i * HELD + k % HELD], k / HELD);
        EACH_HELD(h) {
            float w = spread_second[k * HELD + h];
            FIELD_EACH(i, SPREAD_TOGETHER) sum[i * HELD + h] = fma(w, x[i], sum[i * HELD + h]);
        }
    }
    FIELD_EACH(i, SPREAD_TOGETHER) {
        float logit = 0.0;
        EACH_HELD(h) logit = fma(spread_last[h], rectified(sum[i * HELD + h]), logit);
        spread_logits[first + i] = logit;
    }
}

// Every invocation alone. Weights are loads from addresses that all lanes share; see visibility_weights.glsl.

const uint FIELD_BLOCKS = WIDTH / 4u; // of four neurons
const bool FIELD_ALIGNED = LEVELS % 2u == 0u; // whether rows of the first layer are whole vectors

float field_point[WIDTH]; // the first layer's response to this pixel's point

// Weights of the first layer from input k, an even one, on.
vec4 first_from(uint n, uint k) { return weights_from(n * FIELD_INPUTS + k); }

// Direction and distance of a neuron of the first layer.
float first_layer(vec4 w, vec4 way, float response) {
    return rectified(fma(w.x, way.x, fma(w.y, way.y, fma(w.z, way.z, fma(w.w, way.w, response)))));
}

// Two levels at a time, whose features share a vector of weights.
void alone_respond(vec3 position) {
    FIELD_EACH(n, WIDTH) field_point[n] = 0.0;
    [[dont_unroll]] for (uint l = 0u; l < LEVELS; l += 2u) {
        vec2 one = field_level(l, position), two = vec2(0.0);
        if (FIELD_ALIGNED || l + 1u < LEVELS) two = field_level(l + 1u, position);
        FIELD_EACH(n, WIDTH) {
            vec4 w = first_from(n, 2u * l);
            float sum = fma(w.y, one.y, fma(w.x, one.x, field_point[n]));
            // After an odd number of levels, the weights are those of the direction.
            field_point[n] = FIELD_ALIGNED || l + 1u < LEVELS ? fma(w.w, two.y, fma(w.z, two.x, sum)) : sum;
        }
    }
}

#ifdef MATRIX_UNITS
#include "visibility_matrices.glsl"
#else
#include "visibility_pairs.glsl"
#endif

// Either.

void field_weights() {
    if (FIELD_SPREAD) {
        FILL_COLUMNS(spread_first, FIELD_FEATURES, first_column)
        FILL_COLUMNS(spread_second, WIDTH, second_column)
        FILL_COLUMNS(spread_pair, 4u, pair_column)
        FILL_COLUMNS(spread_last, 1u, last_column)
    }
#ifdef MATRIX_UNITS
    matrices_weights();
#endif
}

// The first layer's response to a point. `position`: in the box's coordinates.
void field_respond(vec3 position) {
    if (FIELD_SPREAD) {
        field_encode(position);
        EACH_ITEM(spread_project)
    } else {
        alone_respond(position);
    }
}

// The same, for the lights that follow.
void field_pixel(vec3 position) {
    field_respond(position);
#ifndef MATRIX_UNITS
    if (!FIELD_SPREAD) pairs_begin();
#endif
}

// Of the lights that are field_way() away.
void field_visibilities(vec4 ways[FIELD_TOGETHER], out float seen[FIELD_TOGETHER]) {
    if (FIELD_SPREAD) {
        spread_way = ways[0];
        FIELD_EACH(i, ITEMS / SPREAD_TOGETHER) spread_layers(i * SPREAD_TOGETHER);
        ITEM_SUMS(spread_logits)
        seen[0] = spread_logits[0];
    } else {
#ifdef MATRIX_UNITS
        seen[0] = matrices_logit(ways[0]);
#else
        pairs_logits(ways, seen);
#endif
    }
    FIELD_EACH(t, FIELD_TOGETHER) seen[t] = 1.0 / (1.0 + exp(-seen[t]));
}

// Layers of visibility_bwd.glsl on matrices: 16-bit operands, 32-bit sums; see matrix_tiles.glsl.
//
// The pairs of a subgroup with a light are the columns. With W the second layer, w the last one, H the outputs of the first
// layer and M the mask of the second layer's positive sums (0 or 1), four products take 16-bit operands:
//     W H                        sums of the second layer, with the rounding of the forward pass
//     (W^T diag(w)) M            gradient of H, over each pair's slope
//     M (slope H)^T              gradient of W, over w
//     (gradient of H) (slope direction)^T   gradient of the first layer's direction and distance
// A slope is the derivative of the loss by a pair's logit. It multiplies a column of the second product after the sum, and M is
// exact, so that gradients of rows and of lights do not depend on the range of slopes. Everything else has 32 bits: the first
// and last layers, the sum of rows over lights, the sums of weights.
//
// Operands are scaled to the range of 16 bits by powers of two, which change no digits. The largest operand is then in
// [2^14, 2^15); an operand loses digits below 2^-29 of it. The scale follows from the largest |W w| for the field, from the
// largest |slope| max H of the subgroup's pairs for the third product, and from the largest |slope| for the fourth. Each
// light's product is scaled back before it is added, so that scales of lights are independent.

const uint WORKGROUP = SUBGROUP;
#define MATRIX_BACKWARD
#define MATRIX_LAYERS 2u
#define MATRIX_ROWS (2u * WIDTH + COLUMNS)
#include "matrix_tiles.glsl"

// The layers, and rows of operands: H; H of the jittered pair, then M, then the gradient of H; directions and distances.
const uint FORWARD = 0u, BACKWARD = 1u;
const uint HIDDEN = 0u, MASK = WIDTH, WAYS = 2u * WIDTH;

const float BOUND = 3e38;    // finite
const float HEADROOM = 64.0; // above 32, the sum of the second product over its largest operand

float layer_scale;    // of W diag(w)
uint above;           // bits of the second layer's sums that are above zero
float largest_hidden; // of the pair

float mlp_at(uint i) { return mlp_vectors[i / 4u][i % 4u]; }

// The power of two that scales numbers up to a largest one; both it and its inverse are normal numbers.
float scale_for(float largest) {
    return uintBitsToFloat(min(268u - (floatBitsToUint(min(largest, BOUND)) >> 23), 253u) << 23);
}

float inverse_of(float scale) { return uintBitsToFloat((254u << 23) - floatBitsToUint(scale)); }

float returned(uint n, uint k) { return clamp(mlp_at(SECOND + n * WIDTH + k) * mlp_at(LAST + n), -BOUND, BOUND); }

void layers_begin() {
    float largest = 0.0;
    [[dont_unroll]] for (uint i = gl_SubgroupInvocationID; i < WIDTH * WIDTH; i += SUBGROUP) {
        largest = max(largest, abs(returned(i / WIDTH, i % WIDTH)));
    }
    layer_scale = scale_for(subgroupMax(largest));
    matrix_begin();
    [[dont_unroll]] for (uint i = gl_SubgroupInvocationID; i < WIDTH / 2u * WIDTH; i += SUBGROUP) {
        uint pair = i / WIDTH, column = i % WIDTH, at = SECOND + 2u * pair * WIDTH + column;
        matrix_put(layer_at(FORWARD), LAYER_PITCH, pair, column, vec2(mlp_at(at), mlp_at(at + WIDTH)));
        vec2 back = vec2(returned(column, 2u * pair), returned(column, 2u * pair + 1u));
        matrix_put(layer_at(BACKWARD), LAYER_PITCH, pair, column, layer_scale * back);
    }
    exchange();
}

// Two neurons of the first layer.
vec2 hidden_pair(uint i, vec4 even, vec4 odd, vec4 way, bool moved) {
    return vec2(first_layer(even, way, row_of(2u * i, moved)), first_layer(odd, way, row_of(2u * i + 1u, moved)));
}

// The logit, from matrix_sums.
float logit_of_sums() {
    float sum_of = 0.0;
    above = 0u;
    EACH(b, BLOCKS) {
        vec4 w = last_from(b);
        EACH(j, 4u) {
            uint n = 4u * b + j;
            float sum = rectified(matrix_sums[n * SUM_PITCH + gl_SubgroupInvocationID]);
            above |= uint(sum > 0.0) << n;
            sum_of = fma(w[j], sum, sum_of);
        }
    }
    return sum_of;
}

// The jittered pair and the pair share loads of the first layer's weights.
float evaluate(FieldStep field, vec3 moved_point, vec3 point, uint light, vec3 place) {
    uint lane = gl_SubgroupInvocationID;
    vec4 moved_way = vec4(0.0);
    if (REGULARIZED) moved_way = field_way(field, moved_point, field_inside(field, place + jitter_of(field, LIGHTS, light)));
    way = field_way(field, point, field_inside(field, place));
    alive = 0u;
    largest_hidden = 0.0;
    [[dont_unroll]] for (uint i = 0u; i < WIDTH / 2u; i++) {
        vec4 even = pair_from(2u * i), odd = pair_from(2u * i + 1u);
        vec2 hidden = hidden_pair(i, even, odd, way, false);
        largest_hidden = max(largest_hidden, max(hidden.x, hidden.y));
        alive |= uint(hidden.x > 0.0) << 2u * i | uint(hidden.y > 0.0) << 2u * i + 1u;
        matrix_put(rows_at(HIDDEN), PITCH, i, lane, hidden);
        if (REGULARIZED) matrix_put(rows_at(MASK), PITCH, i, lane, hidden_pair(i, even, odd, moved_way, true));
    }
    largest_hidden = min(largest_hidden, LARGEST_HALF);
    exchange();
    float moved_logit = 0.0;
    if (REGULARIZED) {
        matrix_product(layer_at(FORWARD), rows_at(MASK));
        exchange();
        moved_logit = logit_of_sums();
        exchange();
    }
    matrix_product(layer_at(FORWARD), rows_at(HIDDEN));
    exchange();
    logit = logit_of_sums();
    return moved_logit;
}

// Operands of the second and third product. Returns the inverse scale of the latter.
float back_operands(float slope) {
    uint lane = gl_SubgroupInvocationID;
    float scale = scale_for(subgroupMax(min(abs(slope) * largest_hidden, BOUND)));
    EACH(i, WIDTH / 2u) {
        matrix_put(rows_at(MASK), PITCH, i, lane, vec2(above >> 2u * i & 1u, above >> 2u * i + 1u & 1u));
        vec2 hidden = matrix_get(rows_at(HIDDEN), PITCH, i, lane);
        matrix_put(rows_at(HIDDEN), PITCH, i, lane, slope * hidden * scale);
    }
    exchange();
    return inverse_of(scale);
}

// From the second product to the row and the way of the pair, and the operands of the fourth product. Returns its inverse scale.
float back_first(float slope) {
    uint lane = gl_SubgroupInvocationID;
    float inverse = inverse_of(layer_scale), own = slope * inverse;
    turn = vec4(0.0);
    EACH(b, BLOCKS) {
        vec4 g;
        EACH(j, 4u) {
            uint k = 4u * b + j;
            g[j] = (alive >> k & 1u) != 0u ? matrix_sums[k * SUM_PITCH + lane] : 0.0;
            turn = fma(vec4(own * g[j]), pair_from(k), turn);
        }
        by_row[b] += own * g;
        matrix_put(rows_at(MASK), PITCH, 2u * b, lane, g.xy / HEADROOM);
        matrix_put(rows_at(MASK), PITCH, 2u * b + 1u, lane, g.zw / HEADROOM);
    }
    float scale = scale_for(subgroupMax(min(2.0 * abs(slope), BOUND)));
    matrix_put(rows_at(WAYS), PITCH, 0u, lane, slope * way.xy * scale);
    matrix_put(rows_at(WAYS), PITCH, 1u, lane, slope * way.zw * scale);
    exchange();
    return min(inverse * HEADROOM * inverse_of(scale), BOUND);
}

// The last layer's gradients are sums over the first layer's outputs, too, by the second layer's weights.
void write_second() {
    uint to = gl_WorkGroupID.x * SUMS;
    exchange();
    [[dont_unroll]] for (uint i = gl_SubgroupInvocationID; i < WIDTH * WIDTH; i += SUBGROUP) {
        sums_of[to + i] = matrix_sums[i / WIDTH * SUM_PITCH + i % WIDTH] * mlp_at(LAST + i / WIDTH);
    }
    [[dont_unroll]] for (uint n = gl_SubgroupInvocationID; n < WIDTH; n += SUBGROUP) {
        float by_last = 0.0;
        [[dont_unroll]] for (uint k = 0u; k < WIDTH; k++) {
            by_last = fma(matrix_sums[n * SUM_PITCH + k], mlp_at(SECOND + n * WIDTH + k), by_last);
        }
        sums_of[to + WIDTH * (WIDTH + 4u) + n] = by_last;
    }
    exchange();
}

void write_pair() {
    uint to = gl_WorkGroupID.x * SUMS + WIDTH * WIDTH;
    exchange();
    [[dont_unroll]] for (uint i = gl_SubgroupInvocationID; i < 4u * WIDTH; i += SUBGROUP) {
        sums_of[to + i] = matrix_sums[i % WIDTH * SUM_PITCH + i / WIDTH];
    }
}

#define LAYER_SUMS                                                                                             \
    MATRIX_SUMS(by_second, WIDTH)                                                                              \
    MATRIX_SUMS(by_pair, COLUMNS)

#define BACK(slope)                                                                                            \
    {                                                                                                          \
        float inverse_ = back_operands(slope);                                                                 \
        matrix_product(layer_at(BACKWARD), rows_at(MASK));                                                     \
        MATRIX_ADD(by_second, WIDTH, rows_at(MASK), rows_at(HIDDEN), inverse_)                                 \
        exchange();                                                                                            \
        inverse_ = back_first(slope);                                                                          \
        MATRIX_ADD(by_pair, COLUMNS, rows_at(MASK), rows_at(WAYS), inverse_)                                   \
        exchange();                                                                                            \
    }

#define WRITE_SUMS                                                                                             \
    MATRIX_STORE(by_second, WIDTH)                                                                             \
    write_second();                                                                                            \
    MATRIX_STORE(by_pair, COLUMNS)                                                                             \
    write_pair();

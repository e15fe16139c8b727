// Second layer of the visibility field on matrices of 16-bit operands; see matrix_tiles.glsl.
//
// Part of visibility_field.glsl where MATRIX_UNITS is defined. The first and last layers stay in 32 bits. A workgroup is a
// subgroup.

#define MATRIX_LAYERS 1u
#define MATRIX_ROWS WIDTH
#include "matrix_tiles.glsl"

void matrices_weights() {
    matrix_begin();
    [[dont_unroll]] for (uint i = gl_LocalInvocationID.x; i < WIDTH / 2u * WIDTH; i += WORKGROUP) {
        uint pair = i / WIDTH, k = i % WIDTH, at = FIELD_SECOND + 2u * pair * WIDTH + k;
        matrix_put(layer_at(0u), LAYER_PITCH, pair, k, vec2(mlp[at], mlp[at + WIDTH]));
    }
    // What comes next waits for the others.
    barrier();
}

float matrices_logit(vec4 way) {
    uint lane = gl_LocalInvocationID.x;
    FIELD_EACH(i, WIDTH / 2u) {
        uint n = 2u * i;
        float even = first_layer(first_from(n, FIELD_FEATURES), way, field_point[n]);
        float odd = first_layer(first_from(n + 1u, FIELD_FEATURES), way, field_point[n + 1u]);
        matrix_put(rows_at(0u), PITCH, i, lane, vec2(even, odd));
    }
    barrier();
    matrix_product(layer_at(0u), rows_at(0u));
    barrier();
    float logit = 0.0;
    FIELD_EACH(b, FIELD_BLOCKS) {
        vec4 w = mlp_vectors[FIELD_LAST / 4u + b];
        FIELD_EACH(j, 4u) logit = fma(w[j], rectified(matrix_sums[(4u * b + j) * SUM_PITCH + lane]), logit);
    }
    return logit;
}

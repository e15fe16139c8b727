// Second layer of the visibility field on matrices of 16-bit operands; see matrix_tiles.glsl.
//
// Part of visibility_field.glsl where MATRIX_UNITS is defined. The first and last layers stay in 32 bits. A workgroup is a
// subgroup.

layout(constant_id = 12) const uint ROWS = 16;    // of a piece of the layer and of the sums
layout(constant_id = 13) const uint COLUMNS = 16; // pixels of a piece
layout(constant_id = 14) const uint DEPTH = 16;   // columns of a piece of the layer

#include "matrix_tiles.glsl"

void matrices_weights() {
    matrix_begin();
    [[dont_unroll]] for (uint i = gl_LocalInvocationID.x; i < WIDTH * WIDTH; i += WORKGROUP) {
        matrix_layer[i] = half_of(mlp[FIELD_SECOND + i]);
    }
    // What comes next waits for the others.
    barrier();
}

float matrices_logit(vec4 way) {
    uint lane = gl_LocalInvocationID.x;
    FIELD_EACH(n, WIDTH) {
        float hidden = first_layer(first_from(n, FIELD_FEATURES), way, field_point[n]);
        matrix_columns[n * BREADTH + lane] = half_of(hidden);
    }
    matrix_product();
    float logit = 0.0;
    FIELD_EACH(b, FIELD_BLOCKS) {
        vec4 w = mlp_vectors[FIELD_LAST / 4u + b];
        FIELD_EACH(j, 4u) logit = fma(w[j], rectified(matrix_sums[(4u * b + j) * BREADTH + lane]), logit);
    }
    return logit;
}

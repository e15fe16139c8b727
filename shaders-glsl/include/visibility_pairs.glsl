// Layers of the visibility field for FIELD_TOGETHER lights of an invocation's pixel, in 32 bits.
//
// Part of visibility_field.glsl. The lights share each load of weights: 32 of the first layer's vectors, 256 of the second's
// and 8 of the last one's. Sums of the second layer are in registers, 32 a light. Outputs of the first layer are computed
// four at a time, right before their use. Responses to points are in shared memory, because a loop indexes them. Each
// invocation reads only its own.

shared float shared_points[FIELD_SPREAD ? 1u : WIDTH * WORKGROUP]; // by neuron and invocation

void pairs_begin() {
    FIELD_EACH(n, WIDTH) shared_points[n * WORKGROUP + gl_LocalInvocationID.x] = field_point[n];
}

void pairs_logits(vec4 ways[FIELD_TOGETHER], out float logits[FIELD_TOGETHER]) {
    float sums[FIELD_TOGETHER * WIDTH];
    FIELD_EACH(i, FIELD_TOGETHER * WIDTH) sums[i] = 0.0;
    // A loop, because instructions do not fit in caches otherwise.
    [[dont_unroll]] for (uint b = 0u; b < FIELD_BLOCKS; b++) {
        vec4 hidden[FIELD_TOGETHER];
        FIELD_EACH(j, 4u) {
            uint k = 4u * b + j;
            vec4 w = first_from(k, FIELD_FEATURES);
            float response = shared_points[k * WORKGROUP + gl_LocalInvocationID.x];
            FIELD_EACH(t, FIELD_TOGETHER) hidden[t][j] = first_layer(w, ways[t], response);
        }
        FIELD_EACH(n, WIDTH) {
            vec4 w = mlp_vectors[FIELD_SECOND / 4u + n * FIELD_BLOCKS + b];
            FIELD_EACH(t, FIELD_TOGETHER) {
                FIELD_EACH(j, 4u) sums[t * WIDTH + n] = fma(w[j], hidden[t][j], sums[t * WIDTH + n]);
            }
        }
    }
    FIELD_EACH(t, FIELD_TOGETHER) logits[t] = 0.0;
    FIELD_EACH(b, FIELD_BLOCKS) {
        vec4 w = mlp_vectors[FIELD_LAST / 4u + b];
        FIELD_EACH(t, FIELD_TOGETHER) {
            FIELD_EACH(j, 4u) logits[t] = fma(w[j], rectified(sums[t * WIDTH + 4u * b + j]), logits[t]);
        }
    }
}

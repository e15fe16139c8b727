// Weights of the visibility field, four each, as a uniform buffer: for loads from addresses that all lanes share. Through a
// storage buffer such a load takes a GPU as long as one from addresses that differ, unless its compiler makes it scalar.
//
// Weights are at most 552 vectors, with 16 levels. Buffers of fields with fewer levels are shorter than the block; nothing
// reads beyond their end.

layout(scalar) uniform mlp_vectors_block { vec4 mlp_vectors[552]; };

// Four weights from an even index on, which lies before the end by more than four.
vec4 weights_from(uint at) {
    vec4 low = mlp_vectors[at / 4u];
    if (LEVELS % 2u == 0u) return low; // rows of the first layer are whole vectors
    vec4 high = mlp_vectors[at / 4u + 1u];
    return at % 4u == 0u ? low : vec4(low.zw, high.xy);
}

// Computes small matrices that replace the decoder in a step: the rows of A^T A, then those of T A.
//
// Each lane computes PER_LANE rows. The sum over 512 terms is split into PARTS; semantic_reduce adds them.
#version 460
#include "common.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint PER_LANE = 1;
layout(constant_id = 3) const uint CLASSES = 1;
layout(constant_id = 4) const uint PARTS = 1;

IN(float, decoder);    // A: 512 rows of 32 weights and a bias
IN(float, embeddings); // T: CLASSES x 512
OUT(vec4, partials);   // PARTS x (33 + CLASSES) rows of 33

#include "shared_rows.glsl"

const uint ROWS = AUGMENTED + CLASSES;

void main() {
    uint part = folded_workgroup() % PARTS;
    uint from = folded_workgroup() / PARTS * SUBGROUP * PER_LANE, first = from + gl_SubgroupInvocationID;
    if (from >= ROWS) return;
    float sums[AUGMENTED * PER_LANE];
    CLEAR_SUMS(sums, PER_LANE)
    for (uint j = part * (EMBEDDING / PARTS); j < (part + 1u) * (EMBEDDING / PARTS); j++) {
        float factors[PER_LANE];
        [[unroll]] for (uint r = 0u; r < PER_LANE; r++) {
            uint i = min(first + r * SUBGROUP, ROWS - 1u);
            float x = 0.0;
            if (i < AUGMENTED) x = decoder[j * AUGMENTED + i];
            else x = embeddings[(i - AUGMENTED) * EMBEDDING + j];
            factors[r] = x;
        }
        FETCH_ROW(row, decoder, j * AUGMENTED)
        ADD_ROW(sums, row, factors, PER_LANE)
    }
    [[unroll]] for (uint r = 0u; r < PER_LANE; r++) {
        uint i = first + r * SUBGROUP;
        if (i < ROWS) {
            STORE_ROW(partials, part * ROWS + i, sums, PER_LANE, r)
        }
    }
}

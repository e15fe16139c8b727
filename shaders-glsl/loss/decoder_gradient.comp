// Gradient of the semantic decoder A: the sum over samples of t (s f')^T, plus A K, plus T^T E.
//
// The first term arrives in SPLITS partial sums. K (33 x 33) and E (CLASSES x 33) are sums that semantic_samples and
// the region kernels wrote. A lane computes one row of the gradient in each of TILES.
#version 460
#include "common.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILES = 1;
layout(constant_id = 3) const uint CLASSES = 1;
layout(constant_id = 4) const uint SPLITS = 1; // partial sums; 0 without targets

IN(float, decoder);     // 512 x 33
IN(float, embeddings);  // CLASSES x 512
IN(float, outer);       // SPLITS x 512 rows
IN(float, accumulated); // rows of K, then of E
OUT(float, gradient);   // 512 x 33

#include "lane_items.glsl"

void main() {
    uint first = folded_workgroup() * SUBGROUP * TILES;
    if (first >= EMBEDDING) return;
    float sums[TILES * SPREAD], bias[TILES];
    [[unroll]] for (uint t = 0u; t < TILES; t++) {
        [[unroll]] for (uint k = 0u; k < SPREAD; k++) sums[t * SPREAD + k] = 0.0;
        bias[t] = 0.0;
    }
    for (uint i = 0u; i < AUGMENTED + CLASSES; i++) {
        float row[HELD];
        EACH_HELD(h) row[h] = accumulated[i * PITCH + h * ACROSS + column()];
        float last = accumulated[i * PITCH + FEATURES];
        [[unroll]] for (uint t = 0u; t < TILES; t++) {
            uint mine = first + t * SUBGROUP + gl_SubgroupInvocationID;
            float factor = 0.0;
            if (i < AUGMENTED) factor = decoder[mine * AUGMENTED + i];
            else factor = embeddings[(i - AUGMENTED) * EMBEDDING + mine];
            bias[t] = fma(factor, last, bias[t]);
            EACH_ITEM(n) {
                float s = subgroupShuffle(factor, lane_of(n));
                uint at = t * SPREAD + n * HELD;
                EACH_HELD(h) sums[at + h] = fma(s, row[h], sums[at + h]);
            }
        }
    }
    [[unroll]] for (uint t = 0u; t < TILES; t++) {
        float staged[SPREAD]; // copy that a variable may index
        [[unroll]] for (uint n = 0u; n < SPREAD; n++) staged[n] = sums[t * SPREAD + n];
        for (uint n = 0u; n < ACROSS; n++) {
            uint at = first + t * SUBGROUP + lane_of(n);
            EACH_HELD(h) {
                float sum = staged[n * HELD + h];
                for (uint s = 0u; s < SPLITS; s++) sum += outer[(s * EMBEDDING + at) * PITCH + h * ACROSS + column()];
                gradient[at * AUGMENTED + h * ACROSS + column()] = sum;
            }
        }
        uint mine = first + t * SUBGROUP + gl_SubgroupInvocationID;
        for (uint s = 0u; s < SPLITS; s++) bias[t] += outer[(s * EMBEDDING + mine) * PITCH + FEATURES];
        gradient[mine * AUGMENTED + FEATURES] = bias[t];
    }
}

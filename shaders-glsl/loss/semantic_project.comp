// Projects every target of the view by the transposed decoder: F A, 33 numbers per sample.
//
// This is the only product over all targets in the forward pass. Each lane processes PER_LANE samples. The sum over 512
// terms is split into PARTS; the kernel that reads the products adds them.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint PER_LANE = 2;
layout(constant_id = 3) const uint PARTS = 1;

layout(push_constant, scalar) uniform Push { uint largest; } push; // samples between the products of two parts

layout(scalar) uniform StepBlock { Step step; } params;

IN(uint, features);   // targets of all views, 512 halves per sample
IN(float, decoder);   // A: 512 x 33
OUT(vec4, products);  // PARTS x largest rows of 33

#include "shared_rows.glsl"

void main() {
    uint samples = params.step.semantic_size.x * params.step.semantic_size.y;
    uint part = folded_workgroup() % PARTS;
    uint from = folded_workgroup() / PARTS * SUBGROUP * PER_LANE, first = from + gl_SubgroupInvocationID;
    if (from >= samples) return;
    uint at[PER_LANE];
    [[unroll]] for (uint r = 0u; r < PER_LANE; r++) {
        at[r] = (params.step.semantic_offset + min(first + r * SUBGROUP, samples - 1u)) * EMBEDDING_WORDS;
    }
    float sums[AUGMENTED * PER_LANE];
    CLEAR_SUMS(sums, PER_LANE)
    const uint WORDS = EMBEDDING_WORDS / PARTS;
    for (uint word = part * WORDS; word < (part + 1u) * WORDS; word++) {
        float low[PER_LANE], high[PER_LANE];
        [[unroll]] for (uint r = 0u; r < PER_LANE; r++) {
            vec2 t = unpackHalf2x16(features[at[r] + word]);
            low[r] = t.x;
            high[r] = t.y;
        }
        FETCH_ROW(even, decoder, 2u * word * AUGMENTED)
        ADD_ROW(sums, even, low, PER_LANE)
        FETCH_ROW(odd, decoder, (2u * word + 1u) * AUGMENTED)
        ADD_ROW(sums, odd, high, PER_LANE)
    }
    [[unroll]] for (uint r = 0u; r < PER_LANE; r++) {
        uint i = first + r * SUBGROUP;
        if (i < samples) {
            STORE_ROW(products, part * push.largest + i, sums, PER_LANE, r)
        }
    }
}

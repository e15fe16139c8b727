// Term of the decoder's gradient that needs the targets: the sum over samples of t (s f')^T.
//
// One workgroup processes a stripe of the 512 rows over one run of samples. decoder_gradient sums the runs. Each lane
// computes 2 x WORDS rows.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint WORDS = 2;  // words of a target per lane; a word has two rows
layout(constant_id = 3) const uint SPLITS = 1; // runs of samples

layout(push_constant, scalar) uniform Push { uint split; } push; // samples per run

layout(scalar) uniform StepBlock { Step step; } params;

IN(uint, features);  // targets of all views, 512 halves per sample
IN(float, rows);     // s f' of each sample, 33 numbers
OUT(vec4, outer);    // SPLITS x 512 rows of 33

#include "shared_rows.glsl"

const uint HELD = 2u * WORDS; // rows per lane
const uint STRIPES = EMBEDDING / (HELD * SUBGROUP);

void main() {
    uint samples = params.step.semantic_size.x * params.step.semantic_size.y;
    uint group = folded_workgroup();
    uint stripe = group % STRIPES, run = group / STRIPES;
    if (run >= SPLITS) return;
    uint end = min((run + 1u) * push.split, samples);
    uint word = stripe * WORDS * SUBGROUP + gl_SubgroupInvocationID;
    float sums[AUGMENTED * HELD];
    CLEAR_SUMS(sums, HELD)
    for (uint i = run * push.split; i < end; i++) {
        FETCH_ROW(row, rows, i * PITCH)
        float t[HELD];
        [[unroll]] for (uint w = 0u; w < WORDS; w++) {
            uint pair = features[(params.step.semantic_offset + i) * EMBEDDING_WORDS + word + w * SUBGROUP];
            // Replace non-finite targets by zero. Their sample has weight zero, but the product would still be NaN.
            pair &= (pair & 0x7c00u) == 0x7c00u ? 0xffff0000u : ~0u;
            pair &= (pair & 0x7c000000u) == 0x7c000000u ? 0xffffu : ~0u;
            vec2 both = unpackHalf2x16(pair);
            t[2u * w] = both.x;
            t[2u * w + 1u] = both.y;
        }
        ADD_ROW(sums, row, t, HELD)
    }
    [[unroll]] for (uint h = 0u; h < HELD; h++) {
        uint at = run * EMBEDDING + 2u * (word + h / 2u * SUBGROUP) + h % 2u;
        STORE_ROW(outer, at, sums, HELD, h)
    }
}

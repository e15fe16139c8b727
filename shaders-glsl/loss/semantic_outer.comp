// The part of the decoder's gradient that needs the targets themselves: the sum over samples of t (s f')^T. A workgroup
// does 64 of the 512 rows over one run of samples; decoder_gradient adds up the runs.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"
#include "semantic_tile.glsl"

layout(constant_id = 0) const uint WORKGROUP = 96;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint SPLIT = 2048;  // samples of a run
layout(constant_id = 3) const uint SPLITS = 1;    // runs

layout(scalar) uniform StepBlock { Step step; } params;

IN(uint, features);  // of all views, 512 halves a sample
IN(float, rows);     // samples x 33: s f'
OUT(float, outer);   // SPLITS x 512 x 33

const uint STRIPES = EMBEDDING / TILE_ROWS;

void main() {
    uint samples = params.step.semantic_size.x * params.step.semantic_size.y;
    uint group = folded_workgroup();
    uint stripe = group % STRIPES, split = group / STRIPES;
    if (split >= SPLITS) return;
    uint end = min((split + 1u) * SPLIT, samples);
    uint lane = gl_LocalInvocationID.x;
    uint row = lane / 6u * 4u, column = lane % 6u * 6u;
    vec4 sums[6];
    [[unroll]] for (uint c = 0u; c < 6u; c++) sums[c] = vec4(0.0);
    for (uint depth = split * SPLIT; depth < end; depth += TILE_DEPTH) {
        for (uint item = lane; item < TILE_ROWS * TILE_DEPTH / 2u; item += WORKGROUP) {
            uint word = item % (TILE_ROWS / 2u), k = item / (TILE_ROWS / 2u);
            vec2 t = vec2(0.0);
            if (depth + k < end) {
                uint at = (params.step.semantic_offset + depth + k) * EMBEDDING_WORDS;
                uint pair = features[at + stripe * (TILE_ROWS / 2u) + word];
                // What is not finite belongs to a sample that does not count; times its zero it would still be NaN.
                if ((pair & 0x7c00u) == 0x7c00u) pair &= 0xffff0000u;
                if ((pair & 0x7c000000u) == 0x7c000000u) pair &= 0xffffu;
                t = unpackHalf2x16(pair);
            }
            left[k * LEFT_PITCH + 2u * word] = t.x;
            left[k * LEFT_PITCH + 2u * word + 1u] = t.y;
        }
        for (uint item = lane; item < TILE_DEPTH * TILE_COLUMNS; item += WORKGROUP) {
            uint c = item % TILE_COLUMNS, k = item / TILE_COLUMNS;
            right[item] = c < AUGMENTED && depth + k < end ? rows[(depth + k) * AUGMENTED + c] : 0.0;
        }
        barrier();
        multiply_tile(row, column, sums);
        barrier();
    }
    [[unroll]] for (uint r = 0u; r < 4u; r++) {
        [[unroll]] for (uint c = 0u; c < 6u; c++) {
            uint at = split * EMBEDDING + stripe * TILE_ROWS + row + r;
            if (column + c < AUGMENTED) outer[at * AUGMENTED + column + c] = sums[c][r];
        }
    }
}

// Every target of the view through the transposed decoder: F A, 33 numbers a sample. The one product over all targets
// of the forward half.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"
#include "semantic_tile.glsl"

layout(constant_id = 0) const uint WORKGROUP = 96;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;

IN(uint, features);  // of all views, 512 halves a sample
IN(float, decoder);  // A: 512 x 33
OUT(float, products); // samples x 33

void main() {
    uint samples = params.step.semantic_size.x * params.step.semantic_size.y;
    uint first = folded_workgroup() * TILE_ROWS;
    if (first >= samples) return;
    uint lane = gl_LocalInvocationID.x;
    uint row = lane / 6u * 4u, column = lane % 6u * 6u;
    vec4 sums[6];
    [[unroll]] for (uint c = 0u; c < 6u; c++) sums[c] = vec4(0.0);
    for (uint depth = 0u; depth < EMBEDDING; depth += TILE_DEPTH) {
        for (uint item = lane; item < TILE_ROWS * TILE_DEPTH / 2u; item += WORKGROUP) {
            uint word = item % 4u + item / (4u * TILE_ROWS) * 4u, r = item / 4u % TILE_ROWS;
            vec2 t = vec2(0.0);
            if (first + r < samples) {
                uint at = (params.step.semantic_offset + first + r) * EMBEDDING_WORDS + depth / 2u + word;
                t = unpackHalf2x16(features[at]);
            }
            left[2u * word * LEFT_PITCH + r] = t.x;
            left[(2u * word + 1u) * LEFT_PITCH + r] = t.y;
        }
        for (uint item = lane; item < TILE_DEPTH * TILE_COLUMNS; item += WORKGROUP) {
            uint c = item % TILE_COLUMNS, k = item / TILE_COLUMNS;
            right[item] = c < AUGMENTED ? decoder[(depth + k) * AUGMENTED + c] : 0.0;
        }
        barrier();
        multiply_tile(row, column, sums);
        barrier();
    }
    [[unroll]] for (uint r = 0u; r < 4u; r++) {
        [[unroll]] for (uint c = 0u; c < 6u; c++) {
            if (first + row + r < samples && column + c < AUGMENTED) {
                products[(first + row + r) * AUGMENTED + column + c] = sums[c][r];
            }
        }
    }
}

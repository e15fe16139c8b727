// The small matrices that stand for the decoder in a step: A^T A and T A. One workgroup a row of them.
#version 460
#include "common.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;

IN(float, decoder);    // A: 512 rows of 32 weights and a bias
IN(float, embeddings); // T: CLASSES x 512
OUT(float, gram);      // 33 x 33
OUT(float, text);      // CLASSES x 33

const uint PARTS = 8u;

shared float parts[PARTS * AUGMENTED];

void main() {
    uint row = folded_workgroup();
    if (row >= AUGMENTED + CLASSES) return;
    bool square = row < AUGMENTED;
    for (uint item = gl_LocalInvocationID.x; item < PARTS * AUGMENTED; item += WORKGROUP) {
        uint column = item % AUGMENTED;
        float sum = 0.0;
        for (uint j = item / AUGMENTED; j < EMBEDDING; j += PARTS) {
            float x = square ? decoder[j * AUGMENTED + row] : embeddings[(row - AUGMENTED) * EMBEDDING + j];
            sum = fma(x, decoder[j * AUGMENTED + column], sum);
        }
        parts[item] = sum;
    }
    barrier();
    for (uint column = gl_LocalInvocationID.x; column < AUGMENTED; column += WORKGROUP) {
        float sum = 0.0;
        for (uint p = 0u; p < PARTS; p++) sum += parts[p * AUGMENTED + column];
        if (square) gram[row * AUGMENTED + column] = sum;
        else text[(row - AUGMENTED) * AUGMENTED + column] = sum;
    }
}

// The gradient by the decoder A: runs of sum t (s f')^T, plus T^T E plus A K, with K (33 x 33) and E (CLASSES x 33) the
// sums that samples and pixels left. One invocation a scalar.
#version 460
#include "common.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;
layout(constant_id = 3) const uint SPLITS = 1; // runs; 0 without targets

IN(float, decoder);
IN(float, embeddings);
IN(float, outer);
IN(float, accumulated); // K, then E
OUT(float, gradient);   // 512 x 33

void main() {
    uint at = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (at >= EMBEDDING * AUGMENTED) return;
    uint row = at / AUGMENTED, column = at % AUGMENTED;
    float sum = 0.0;
    for (uint split = 0u; split < SPLITS; split++) sum += outer[split * EMBEDDING * AUGMENTED + at];
    for (uint k = 0u; k < AUGMENTED; k++) {
        sum = fma(decoder[row * AUGMENTED + k], accumulated[k * AUGMENTED + column], sum);
    }
    for (uint c = 0u; c < CLASSES; c++) {
        sum = fma(embeddings[c * EMBEDDING + row], accumulated[(AUGMENTED + c) * AUGMENTED + column], sum);
    }
    gradient[at] = sum;
}

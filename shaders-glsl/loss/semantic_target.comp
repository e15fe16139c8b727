// Precomputes a semantic target: its inverse norm, and the class of the closest text embedding. One subgroup per
// sample.
#version 460
#include "common.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;
layout(constant_id = 3) const bool HAS_LABELS = false; // whether to take labels from `labels` instead of the target

layout(push_constant, scalar) uniform Push { uint samples; } push;

IN(uint, features);     // samples x 512 halves
IN(float, embeddings);  // CLASSES x 512, unit length
IN(uint, labels);       // one per sample; read only with HAS_LABELS
OUT(SemanticTarget, targets);

void main() {
    uint at = folded_workgroup();
    if (at >= push.samples) return;
    uint lane = gl_LocalInvocationID.x;
    float square = 0.0;
    bool finite = true;
    for (uint w = lane; w < EMBEDDING_WORDS; w += SUBGROUP) {
        uint word = features[at * EMBEDDING_WORDS + w];
        finite = finite && (word & 0x7c00u) != 0x7c00u && (word & 0x7c000000u) != 0x7c000000u;
        vec2 t = unpackHalf2x16(word);
        square += dot(t, t);
    }
    finite = subgroupAll(finite);
    square = subgroupAdd(finite ? square : 0.0);
    bool valid = finite && square > 0.0;
    uint label = NO_LABEL;
    if (HAS_LABELS) {
        if (valid && labels[at] < CLASSES) label = labels[at];
    } else if (valid) {
        float best = -1e38;
        for (uint c = 0u; c < CLASSES; c++) {
            float product = 0.0;
            for (uint w = lane; w < EMBEDDING_WORDS; w += SUBGROUP) {
                vec2 t = unpackHalf2x16(features[at * EMBEDDING_WORDS + w]);
                uint e = c * EMBEDDING + 2u * w;
                product += t.x * embeddings[e] + t.y * embeddings[e + 1u];
            }
            product = subgroupAdd(product);
            if (product > best) {
                best = product;
                label = c;
            }
        }
    }
    if (lane == 0u) targets[at] = SemanticTarget(valid ? 1.0 / sqrt(square) : 0.0, label);
}

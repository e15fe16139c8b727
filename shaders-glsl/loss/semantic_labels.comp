// The class of every pixel of a picture, and how much it has of one class.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 128;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;
layout(constant_id = 3) const uint CHANNELS = 35;
layout(constant_id = 4) const uint FIRST = 3;
layout(constant_id = 5) const bool COSINE = false; // relevance: the cosine; else the softmax's probability

layout(push_constant, scalar) uniform Push { uint query; } push; // class of the relevance

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(float, gram);
IN(float, text);
OUT(uint, labels);     // NO_LABEL where a feature is not finite
OUT(float, relevance); // 0 there

#include "semantic_decode.glsl"

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    float f[AUGMENTED], u[AUGMENTED];
    float inverse;
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) f[k] = image[pixel * CHANNELS + FIRST + k];
    f[FEATURES] = 1.0;
    bool finite = decode(f, u, inverse);
    uint label = NO_LABEL;
    float best = -1e38, asked = 0.0;
    if (finite) {
        for (uint c = 0u; c < CLASSES; c++) {
            float product = class_product(c, f);
            if (product > best) {
                best = product;
                label = c;
            }
        }
        if (COSINE) {
            asked = class_product(push.query, f) * inverse;
        } else {
            Softmax s = softmax_of(f, inverse * params.step.inverse_temperature, push.query);
            asked = exp(s.chosen - s.top) / s.total;
        }
    }
    labels[pixel] = label;
    relevance[pixel] = asked;
}

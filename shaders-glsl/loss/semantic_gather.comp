// The gradient of the sampled features, back to the pixels that they were sampled from. Each pixel adds up its samples in
// their order, so nothing is added atomically. One invocation has four of a pixel's 32 channels.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CHANNELS = 35; // floats of a pixel of the gradient
layout(constant_id = 3) const uint FIRST = 3;     // channel of the first feature

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, grad_features); // samples x 32
OUT(float, grad_image);   // all features' channels of every pixel

const uint QUADS = FEATURES / 4u;

// Samples that touch pixel `at`: first, and one past the last.
uvec2 span(uint at, uint samples, uint pixels) {
    if (samples <= 1u || pixels == 1u) return at == 0u ? uvec2(0u, samples) : uvec2(0u);
    uint across = pixels - 1u, steps = samples - 1u;
    uint low = at == 0u ? 0u : (at - 1u) * steps / across + 1u;
    uint high = min(((at + 1u) * steps - 1u) / across, steps);
    return uvec2(low, high + 1u);
}

float weight_of(uint i, uint at, uint samples, uint pixels) {
    vec2 w;
    uint begin = aligned(i, samples, pixels, w);
    return begin == at ? w.x : begin + 1u == at ? w.y : 0.0;
}

void main() {
    uvec2 size = params.step.camera.size, map = params.step.semantic_size;
    uint item = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uint pixel = item / QUADS, quad = item % QUADS * 4u;
    if (pixel >= size.x * size.y) return;
    uint x = pixel % size.x, y = pixel / size.x;
    uvec2 columns = span(x, map.x, size.x), rows = span(y, map.y, size.y);
    vec4 sum = vec4(0.0);
    for (uint row = rows.x; row < rows.y; row++) {
        float wy = weight_of(row, y, map.y, size.y);
        for (uint column = columns.x; column < columns.y; column++) {
            float w = wy * weight_of(column, x, map.x, size.x);
            uint at = (row * map.x + column) * FEATURES + quad;
            sum += w * vec4(grad_features[at], grad_features[at + 1u], grad_features[at + 2u], grad_features[at + 3u]);
        }
    }
    uint to = pixel * CHANNELS + FIRST + quad;
    [[unroll]] for (uint k = 0u; k < 4u; k++) grad_image[to + k] = sum[k];
}

// Backward of feature sampling: gathers gradients of samples at the pixels of `pixel_mask`.
//
// Each pixel sums its samples in a fixed order, without atomics.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CHANNELS = 35; // floats of a pixel of the gradient
layout(constant_id = 3) const uint FIRST = 3;     // channel of the first feature
layout(constant_id = 4) const uint ACROSS = 8;    // lanes per pixel

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, grad_features); // samples x 32
IN(uint, pixel_mask);         // one bit per pixel
OUT(float, grad_image);   // channels of all features, written where the pixel's bit is set

#define MASK(word) pixel_mask[word]
#include "listed_mask.glsl"

const uint HELD = FEATURES / ACROSS; // channels per lane

// Returns the range of samples that are interpolated from pixel `at`: first, and one past the last.
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
    uint within = gl_SubgroupInvocationID / ACROSS, channel = gl_SubgroupInvocationID % ACROSS * HELD;
    uint block = gl_WorkGroupID.x, blocks = list_blocks(size.x * size.y);
    while (block < blocks) {
        uint count = fill_list(block, size.x * size.y);
        for (uint from = 0u; from < count; from += SUBGROUP / ACROSS) {
            uint pixel = listed[min(from + within, count - 1u)];
            uint x = pixel % size.x, y = pixel / size.x;
            uvec2 columns = span(x, map.x, size.x), rows = span(y, map.y, size.y);
            float sum[HELD]; // indexed by a variable, since HELD may be large
            for (uint h = 0u; h < HELD; h++) sum[h] = 0.0;
            for (uint row = rows.x; row < rows.y; row++) {
                float wy = weight_of(row, y, map.y, size.y);
                for (uint column = columns.x; column < columns.y; column++) {
                    float w = wy * weight_of(column, x, map.x, size.x);
                    uint at = (row * map.x + column) * FEATURES + channel;
                    for (uint h = 0u; h < HELD; h++) sum[h] += w * grad_features[at + h];
                }
            }
            uint to = pixel * CHANNELS + FIRST + channel;
            if (from + within < count) {
                for (uint h = 0u; h < HELD; h++) grad_image[to + h] = sum[h];
            }
        }
    }
}

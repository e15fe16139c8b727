// Marks the pixels of a view whose features the loss reads, as a bit mask.
//
// These are the pixels from which samples of the target map are interpolated, and those of a region. One invocation per
// word of 32 pixels.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool REGION = false;

layout(scalar) uniform StepBlock { Step step; } params;

IN(uint, mask);    // one bit per pixel, from word `mask_offset` of the step
OUT(uint, pixel_mask); // one bit per pixel, from word 0

// Returns whether a sample is interpolated from pixel `at`, along an axis of `samples` samples and `pixels` pixels.
// Such a sample lies less than a pixel away. The first and last samples align with the first and last pixels.
bool touched(uint at, uint samples, uint pixels) {
    if (samples == 0u) return false;
    if (samples == 1u || pixels == 1u) return at == 0u;
    uint across = pixels - 1u, steps = samples - 1u;
    uint low = at == 0u ? 0u : (at - 1u) * steps / across + 1u;
    return low <= steps && low * across < (at + 1u) * steps;
}

void main() {
    uvec2 size = params.step.camera.size, map = params.step.semantic_size;
    uint word = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uint pixels = size.x * size.y;
    if (word * 32u >= pixels) return;
    uint bits = 0u;
    for (uint i = 0u; i < 32u; ++i) {
        uint pixel = word * 32u + i;
        bool wants = pixel < pixels && touched(pixel % size.x, map.x, size.x) && touched(pixel / size.x, map.y, size.y);
        bits |= uint(wants) << i;
    }
    if (REGION) bits |= mask[params.step.mask_offset + word];
    pixel_mask[word] = bits;
}

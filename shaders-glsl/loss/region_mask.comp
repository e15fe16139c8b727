// Marks the pixels of a training view that belong to the step's region, as a bit mask.
//
// One invocation computes one word. Its 32 ids are half a cache line that no other invocation reads.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;

IN(uint, ids);   // region ids of all views, 16 bits per pixel, the lower half first
OUT(uint, mask); // one bit per pixel of the view

void main() {
    uint word = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (word >= mask.length()) return;
    uvec2 size = params.step.camera.size;
    uint pixels = size.x * size.y, first = 32u * word;
    uint region = params.step.region, bits = 0u;
    // Id 0 is no region, and ids have at most 16 bits.
    if (region - 1u < 0xffffu && first < pixels) {
        uint count = min(pixels - first, 32u);
        uint at = params.step.region_offset + first, odd = at & 1u;
        for (uint i = 0u; 2u * i < count + odd; i++) {
            uint pair = ids[at / 2u + i] ^ region * 0x10001u;
            uint equal = uint((pair & 0xffffu) == 0u) | uint(pair >> 16u == 0u) << 1u;
            // If the view begins in the middle of a word, all bits move down by one pixel.
            uint place = 2u * i;
            bits |= place >= odd ? equal << (place - odd) : equal >> 1u;
        }
        if (count < 32u) bits &= (1u << count) - 1u;
    }
    mask[word] = bits;
}

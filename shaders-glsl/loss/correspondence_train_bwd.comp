// Gradient of the pseudo-views' correspondence losses by the training view's mean features, added to its region.
//
// Consecutive lanes hold consecutive features of a pixel.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CHANNELS = 35;
layout(constant_id = 3) const uint FIRST = 3;
layout(constant_id = 4) const uint PAIRS = 2; // pseudo-views

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(uint, mask);
IN(Region, regions); // of the training view, then of the pseudo-views
INOUT(float, grad_image);

#include "lane_items.glsl"
#include "lane_region.glsl"

#define MASK(word) mask[params.step.mask_offset + word]
#include "listed_mask.glsl"

void main() {
    uint pixels = params.step.camera.size.x * params.step.camera.size.y;
    float gradient[HELD];
    EACH_HELD(h) gradient[h] = 0.0;
    for (uint p = 0u; p < PAIRS; p++) {
        LANE_DIRECTION(direction, counts, regions[0], regions[1u + p])
        EACH_HELD(h) gradient[h] += direction[h];
    }
    float weight = params.step.weight_correspondence / (float(PAIRS) * max(regions[0].count, 1.0));
    EACH_HELD(h) gradient[h] *= weight;
    uint block = gl_WorkGroupID.x, blocks = list_blocks(pixels), side = gl_SubgroupInvocationID / ACROSS;
    while (block < blocks) {
        uint count = fill_list(block, pixels);
        for (uint from = 0u; from < count; from += SIDES) {
            uint at = listed[min(from + side, count - 1u)] * CHANNELS + FIRST + column();
            bool finite = true;
            EACH_HELD(h) finite = finite && finite_bits(image[at + h * ACROSS]);
            // A side has at most 32 lanes, which is one word of the ballot. Narrow subgroups have one side.
            bool all = subgroupBallot(!finite)[side] == 0u;
            if (from + side < count && all) {
                EACH_HELD(h) grad_image[at + h * ACROSS] += gradient[h];
            }
        }
    }
}

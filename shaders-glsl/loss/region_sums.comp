// Sums features over a region and counts its pixels by class, in batches of pixels.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILES = 1;
layout(constant_id = 3) const uint CLASSES = 1;
layout(constant_id = 4) const uint CHANNELS = 35;
layout(constant_id = 5) const uint FIRST = 3;
layout(constant_id = 6) const bool CLASSIFY = true; // false leaves the histogram unchanged

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(uint, mask);          // one bit per pixel
IN(float, matrices);
OUT(float, region_sums); // by workgroup: 32 features, number of pixels
INOUT(uint, histogram);  // CLASSES

#include "semantic_batch.glsl"
#include "fetch_items.glsl"

#define MASK(word) mask[params.step.mask_offset + word]
#include "listed_mask.glsl"

void main() {
    uint pixels = params.step.camera.size.x * params.step.camera.size.y;
    if (CLASSIFY) keep_rows();
    float sums[HELD], found = 0.0;
    EACH_HELD(h) sums[h] = 0.0;
    uint block = gl_WorkGroupID.x, blocks = list_blocks(pixels);
    while (block < blocks) {
        uint count = fill_list(block, pixels);
        // Sums of sums lose less precision. Differences of means may be smaller than the rounding error of one long
        // sum.
        float of_list[HELD];
        EACH_HELD(h) of_list[h] = 0.0;
        for (uint from = 0u; from < count; from += BATCH) {
            EACH_TILE(t) live[t] = from + t * SUBGROUP + gl_SubgroupInvocationID < count;
            FETCH_ITEMS(listed[min(from + t * SUBGROUP + lane_of(n), count - 1u)])
            bring();
            float of_batch[HELD];
            EACH_HELD(h) of_batch[h] = 0.0;
            EACH_TILE(t) {
                found += live[t] ? 1.0 : 0.0;
                EACH_ITEM(n) {
                    bool lives = subgroupShuffle(uint(live[t]), lane_of(n)) != 0u;
                    EACH_HELD(h) of_batch[h] += lives ? staged[t * SPREAD + n * HELD + h] : 0.0;
                }
            }
            EACH_HELD(h) of_list[h] += of_batch[h];
            if (CLASSIFY) {
                float best[TILES];
                uint label[TILES];
                EACH_TILE(t) {
                    best[t] = -1e38;
                    label[t] = 0u;
                }
                for (uint c = 0u; c < CLASSES; c++) {
                    fetch_row(AUGMENTED + c);
                    EACH_TILE(t) {
                        float sum = product(t);
                        label[t] = sum > best[t] ? c : label[t];
                        best[t] = max(best[t], sum);
                    }
                }
                EACH_TILE(t) if (live[t]) atomicAdd(histogram[label[t]], 1u);
            }
        }
        EACH_HELD(h) sums[h] += of_list[h];
    }
    uint to = gl_WorkGroupID.x * AUGMENTED;
    EACH_HELD(h) {
        float sum = sums[h];
        for (uint reach = ACROSS; reach < SUBGROUP; reach *= 2u) sum += subgroupShuffleXor(sum, reach);
        if (gl_SubgroupInvocationID < ACROSS) region_sums[to + h * ACROSS + gl_SubgroupInvocationID] = sum;
    }
    found = subgroupAdd(found);
    if (subgroupElect()) region_sums[to + FEATURES] = found;
}

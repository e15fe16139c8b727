// Correspondence loss of one pseudo-view against the training view.
//
// The pixels of the pseudo-view's region should have the class of the training view's region. The mean features of both
// regions should agree. Writes the gradient of the region's pixels and leaves other pixels unchanged.
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

layout(push_constant, scalar) uniform Push { float share; } push; // share of this pseudo-view in the weight

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(uint, mask);
IN(float, matrices);
IN(Region, trained); // region of the training view
IN(Region, region);  // region of this pseudo-view
OUT(float, grad_image);
OUT(float, partials);
OUT(float, sums);    // cross-entropy by workgroup

#include "semantic_sums.glsl"
#include "fetch_items.glsl"
#include "lane_region.glsl"

#define MASK(word) mask[params.step.mask_offset + word]
#include "listed_mask.glsl"

float gradients[TILES * SPREAD]; // laid out like `staged`

void main() {
    uint pixels = params.step.camera.size.x * params.step.camera.size.y;
    LANE_DIRECTION(direction, counts, region[0], trained[0])
    float weight = counts ? params.step.weight_correspondence * push.share / region[0].count : 0.0;
    EACH_TILE(t) label[t] = trained[0].majority;
    float sum = 0.0;
    keep_rows();
    clear_sums();
    uint block = gl_WorkGroupID.x, blocks = list_blocks(pixels);
    while (block < blocks) {
        uint count = fill_list(block, pixels);
        for (uint from = 0u; from < count; from += BATCH) {
            EACH_TILE(t) {
                live[t] = counts && from + t * SUBGROUP + gl_SubgroupInvocationID < count;
                own[t] = 0.0;
                [[unroll]] for (uint k = 0u; k < SPREAD; k++) a[t * SPREAD + k] = 0.0;
            }
            FETCH_ITEMS(listed[min(from + t * SUBGROUP + lane_of(n), count - 1u)])
            bring();
            measure();
            sum += descend(weight);
            EACH_TILE(t) EACH_ITEM(n) {
                float by = subgroupShuffle(bias[t], lane_of(n)), w = by > 0.0 ? weight : 0.0;
                EACH_HELD(h) {
                    uint k = t * SPREAD + n * HELD + h;
                    gradients[k] = fma(w, direction[h], by * a[k]);
                }
            }
            SHORT for (uint t = 0u; t < TILES; t++) {
                SHORT for (uint n = 0u; n < ACROSS; n++) {
                    uint item = from + t * SUBGROUP + lane_of(n);
                    if (item < count) {
                        uint at = listed[item] * CHANNELS + FIRST + column();
                        EACH_HELD(h) grad_image[at + h * ACROSS] = gradients[t * SPREAD + n * HELD + h];
                    }
                }
            }
        }
    }
    write_sums();
    sum = subgroupAdd(sum);
    if (subgroupElect()) sums[gl_WorkGroupID.x] = sum;
}

// Blends raw features of the Gaussians (semantics) at the pixels of `pixel_mask`, with the weights of blend.
//
// Other pixels of the feature image are not written. A tile has a workgroup for every SPAN pixels that it may have to do.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 2; // selected pixels of a lane at a time
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(constant_id = 4) const uint FEATURES = 32;
layout(constant_id = 5) const uint SPAN = 64;    // selected pixels of a workgroup
layout(local_size_x_id = 0) in;

const uint SPANS = (TILE_WIDTH * TILE_HEIGHT + SPAN - 1u) / SPAN; // of a tile

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
IN(uint, splat_ids);
IN(float, raw_features);   // [Gaussians * FEATURES]
IN(uint, pixel_mask);          // a bit a pixel
OUT(float, feature_image); // [pixels * FEATURES], where its bit is set

#include "lane_features.glsl"
#include "pixel_mask.glsl"
#include "lane_hits.glsl"

void main() {
    Camera camera = params.step.camera;
    uint tile = folded_workgroup() / SPANS, first = folded_workgroup() % SPANS * SPAN;
    if (tile >= camera.tiles.x * camera.tiles.y) return;
    uvec2 corner = uvec2(tile % camera.tiles.x, tile / camera.tiles.x) * uvec2(TILE_WIDTH, TILE_HEIGHT);
    uint pixels = list_marked_pixels(corner, camera.size, first);
    if (pixels <= first) return;
    uint begin = tile_ranges[2u * tile], end = tile_ranges[2u * tile + 1u];
    for (uint from = first; from < min(first + SPAN, pixels); from += SUBGROUP * PER_LANE) {
        uint at[PER_LANE];
        vec2 center[PER_LANE];
        float T[PER_LANE];
        float sum[PER_LANE * FEATURES];
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
            uint item = from + k * SUBGROUP + gl_SubgroupInvocationID;
            uint packed = listed[min(item, pixels - 1u)];
            uvec2 pixel = uvec2(packed & 0xffffu, packed >> 16);
            at[k] = pixel.y * camera.size.x + pixel.x;
            center[k] = vec2(pixel) + 0.5;
            T[k] = item < pixels ? 1.0 : -1.0;
            [[unroll]] for (uint c = 0u; c < FEATURES; ++c) sum[k * FEATURES + c] = 0.0;
        }
        for (uint batch = begin; batch < end; batch += SUBGROUP) {
            float best = -1.0;
            [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) best = max(best, T[k]);
            if (subgroupAll(best < 0.0)) break;
            uint mine = min(batch + gl_SubgroupInvocationID, end - 1u);
            uint v = entry_splats[sorted_entries[mine]];
            Splat s = splats[v];
            uint gaussian = splat_ids[v];
            uint own_slots;
            uvec4 hits = lane_hits(s, batch + gl_SubgroupInvocationID < end, center, own_slots);
            while (any_lane(hits)) {
                uint i = next_lane(hits);
                float mx = subgroupShuffle(s.mean.x, i), my = subgroupShuffle(s.mean.y, i);
                float u11 = subgroupShuffle(s.factor.x, i), u12 = subgroupShuffle(s.factor.y, i);
                float u22 = subgroupShuffle(s.factor.z, i), opacity = subgroupShuffle(s.opacity, i);
                uint slots = subgroupShuffle(own_slots, i);
                float weight[PER_LANE];
                float shows = 0.0;
                [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                    weight[k] = 0.0;
                    if (!in_slots(slots, k)) continue;
                    float dx = center[k].x - mx, dy = center[k].y - my;
                    float p = u11 * dx + u12 * dy;
                    float q = u22 * dy;
                    float alpha = min(ALPHA_MAX, opacity * exp2(-(p * p + q * q)));
                    alpha = alpha >= ALPHA_MIN && T[k] > 0.0 ? alpha : 0.0;
                    float next = T[k] - alpha * T[k];
                    bool stop = alpha > 0.0 && next < TRANSMITTANCE_MIN;
                    weight[k] = stop && !KEEP_LAST ? 0.0 : alpha * T[k];
                    T[k] = stop ? -(KEEP_LAST ? next : T[k]) : next;
                    shows = max(shows, weight[k]);
                }
                if (subgroupAny(shows > 0.0)) {
                    LANE_FEATURES(feature, subgroupShuffle(gaussian, i))
                    [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                        if (!in_slots(slots, k)) continue;
                        [[unroll]] for (uint c = 0u; c < FEATURES; ++c)
                            sum[k * FEATURES + c] += weight[k] * feature[c];
                    }
                }
            }
        }
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
            if (from + k * SUBGROUP + gl_SubgroupInvocationID < pixels) {
                [[unroll]] for (uint c = 0u; c < FEATURES; ++c)
                    feature_image[at[k] * FEATURES + c] = sum[k * FEATURES + c];
            }
        }
    }
}

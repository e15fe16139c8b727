// Backward of blend_features: gradients of every entry's features, opacity and footprint from the selected pixels.
//
// Gradients of opacity and footprint are linear in the gradients of the channels. Those that come through features are
// computed separately here and added to the others where the entries of a splat are summed. An entry that covers no
// selected pixel is not written; its flag stays 0. The first dispatch does all selected pixels of tiles of up to SHORT
// entries, and SPAN of longer ones; the next does the SPAN of these from `first` on.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"
#include "blend_bwd.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 2;
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(constant_id = 4) const uint FEATURES = 32;
layout(constant_id = 5) const uint SPAN = 256;
layout(constant_id = 6) const uint SHORT = 0;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint first; } push;

const uint GRADIENTS = MOMENTS + FEATURES;
const uint PARTS = (GRADIENTS + SUBGROUP - 1u) / SUBGROUP;

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
IN(uint, splat_ids);
IN(float, raw_features);
IN(uint, pixel_mask);
IN(float, feature_image);
IN(float, grad_features);     // [pixels * FEATURES], where its bit is set
INOUT(float, entry_features); // [entries * GRADIENTS]: moments, then features; where the flag is up
INOUT(uint, entry_flags);     // by entry; zero at first

#include "lane_sums.glsl"
#include "lane_features.glsl"
#include "pixel_mask.glsl"
#include "lane_hits.glsl"

void main() {
    Camera camera = params.step.camera;
    uint tile = folded_workgroup();
    if (tile >= camera.tiles.x * camera.tiles.y) return;
    uint begin = tile_ranges[2u * tile], end = tile_ranges[2u * tile + 1u];
    bool is_short = end - begin <= SHORT;
    if (is_short && push.first > 0u) return;
    uvec2 corner = uvec2(tile % camera.tiles.x, tile / camera.tiles.x) * uvec2(TILE_WIDTH, TILE_HEIGHT);
    uint pixels = list_marked_pixels(corner, camera.size, push.first);
    if (pixels <= push.first) return;
    uint until = is_short ? pixels : min(push.first + SPAN, pixels);
    for (uint from = push.first; from < until; from += SUBGROUP * PER_LANE) {
        vec2 center[PER_LANE];
        float T[PER_LANE];
        float R[PER_LANE];
        float g[PER_LANE * FEATURES];
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
            uint item = from + k * SUBGROUP + gl_SubgroupInvocationID;
            uint packed = listed[min(item, pixels - 1u)];
            uvec2 pixel = uvec2(packed & 0xffffu, packed >> 16);
            uint at = (pixel.y * camera.size.x + pixel.x) * FEATURES;
            center[k] = vec2(pixel) + 0.5;
            T[k] = item < pixels ? 1.0 : -1.0;
            R[k] = 0.0;
            [[unroll]] for (uint c = 0u; c < FEATURES; ++c) {
                float gradient = item < pixels ? grad_features[at + c] : 0.0;
                g[k * FEATURES + c] = gradient;
                R[k] += item < pixels ? feature_image[at + c] * gradient : 0.0;
            }
        }
        for (uint batch = begin; batch < end; batch += SUBGROUP) {
            float best = -1.0;
            [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) best = max(best, T[k]);
            if (subgroupAll(best < 0.0)) break;
            uint entry = sorted_entries[min(batch + gl_SubgroupInvocationID, end - 1u)];
            uint v = entry_splats[entry];
            Splat s = splats[v];
            uint gaussian = splat_ids[v];
            uint left = entry_flags[entry]; // whether an earlier part of the list has left something
            bool contributes = false;
            uint own_slots;
            uvec4 hits = lane_hits(s, batch + gl_SubgroupInvocationID < end, center, own_slots);
            while (any_lane(hits)) {
                uint i = next_lane(hits);
                float mx = subgroupShuffle(s.mean.x, i), my = subgroupShuffle(s.mean.y, i);
                float u11 = subgroupShuffle(s.factor.x, i), u12 = subgroupShuffle(s.factor.y, i);
                float u22 = subgroupShuffle(s.factor.z, i), opacity = subgroupShuffle(s.opacity, i);
                LANE_FEATURES(feature, subgroupShuffle(gaussian, i))
                float sum[PARTS * SUBGROUP];
                [[unroll]] for (uint j = 0u; j < PARTS * SUBGROUP; ++j) sum[j] = 0.0;
                uint slots = subgroupShuffle(own_slots, i);
                float shows = 0.0;
                [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                    if (!in_slots(slots, k)) continue;
                    float dx = center[k].x - mx, dy = center[k].y - my;
                    float p = u11 * dx + u12 * dy;
                    float q = u22 * dy;
                    float raw = opacity * exp2(-(p * p + q * q));
                    float alpha = min(ALPHA_MAX, raw);
                    alpha = alpha >= ALPHA_MIN && T[k] > 0.0 ? alpha : 0.0;
                    float next = T[k] - alpha * T[k];
                    bool stop = alpha > 0.0 && next < TRANSMITTANCE_MIN;
                    float w = stop && !KEEP_LAST ? 0.0 : alpha * T[k];
                    float s_dot_g = 0.0;
                    [[unroll]] for (uint c = 0u; c < FEATURES; ++c) {
                        sum[MOMENTS + c] += w * g[k * FEATURES + c];
                        s_dot_g += feature[c] * g[k * FEATURES + c];
                    }
                    R[k] -= w * s_dot_g;
                    float h = w > 0.0 && raw <= ALPHA_MAX
                        ? -0.69314718055994531 * alpha * (T[k] * s_dot_g - R[k] / (1.0 - alpha)) : 0.0;
                    float hp = h * p;
                    float hy = h * dy;
                    sum[0] += h;
                    sum[1] += hp;
                    sum[2] += hp * p;
                    sum[3] += hp * dy;
                    sum[4] += hy;
                    sum[5] += hy * dy;
                    T[k] = stop ? -(KEEP_LAST ? next : T[k]) : next;
                    shows = max(shows, w);
                }
                if (subgroupAny(shows > 0.0)) {
                    uint at_entry = subgroupShuffle(entry, i);
                    bool first = subgroupShuffle(left, i) == 0u;
                    contributes = contributes || i == gl_SubgroupInvocationID;
                    [[unroll]] for (uint part = 0u; part < PARTS; ++part) {
                        float lane_sum[SUBGROUP];
                        [[unroll]] for (uint j = 0u; j < SUBGROUP; ++j) lane_sum[j] = sum[part * SUBGROUP + j];
                        LANE_SUMS_OF(lane_sum, GRADIENTS - part * SUBGROUP)
                        uint j = part * SUBGROUP + lane_of_sum();
                        if (j < GRADIENTS) {
                            uint into = at_entry * GRADIENTS + j;
                            entry_features[into] = first ? lane_sum[0] : entry_features[into] + lane_sum[0];
                        }
                    }
                }
            }
            // Only this lane writes the entry, in every part of the list.
            // (Lanes past the end have the last entry, and never show.)
            if (contributes) entry_flags[entry] = 1u;
        }
    }
}

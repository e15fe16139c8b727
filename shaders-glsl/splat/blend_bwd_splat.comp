// Backward of blend, one lane a splat: pixels are walked one by one, transmittance and debt run along the lanes by
// prefix operations. Sums stay in their lane, so no final reduction is needed.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"
#include "blend_bwd.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 8;
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(constant_id = 4) const uint CHANNELS = 3;
layout(constant_id = 5) const uint WEIGHTS = 0;
layout(local_size_x_id = 0) in;
#include "channels.glsl"
#include "tile.glsl"
#include "sub_tiles.glsl"
#include "statistic.glsl"

const uint PIECE = SUBGROUP <= 16u ? SUBGROUP : 1u;
const uint GRADIENTS = MOMENTS + CHANNELS + WEIGHTS + STATISTIC_FLOATS;

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
IN(uint, features);
IN(float, grad_image);
IN(float, debt);
IN(float, statistic_debt); // the debt of the losses that enter the statistic
OUT(float, entry_gradients);

void main() {
    Camera camera = params.step.camera;
    Tile tile = this_tile(camera);
    if (tile.index >= camera.tiles.x * camera.tiles.y) return;
    uint begin = tile_ranges[2u * tile.index], end = tile_ranges[2u * tile.index + 1u];
    if (begin >= end) return;
    // Each lane keeps the state of its own pixels and hands it around.
    float T[PER_LANE];
    float R[PER_LANE];
    float statistic_R[PER_LANE];
    float g[PER_LANE * CHANNELS];
    [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
        uvec2 pixel = tile.first + slot_corner(k);
        bool inside = all(lessThan(pixel, camera.size));
        uint at = inside ? pixel.y * camera.size.x + pixel.x : 0u;
        T[k] = inside ? 1.0 : -1.0;
        R[k] = inside ? debt[at] : 0.0;
        if (STATISTIC_FLOATS > 0u) statistic_R[k] = inside ? statistic_debt[at] : 0.0;
        [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) {
            g[k * CHANNELS + c] = inside ? grad_image[at * CHANNELS + c] : 0.0;
        }
    }
    uint lane = gl_SubgroupInvocationID;
    vec2 corner = vec2(tile.corner) + 0.5;
    for (uint batch = begin; batch < end; batch += SUBGROUP) {
        uint mine = min(batch + lane, end - 1u);
        bool real = batch + lane < end;
        uint entry = sorted_entries[mine];
        float total[MOMENTS];
        float total_color[CHANNELS];
        float total_weight = 0.0;
        vec2 total_statistic = vec2(0.0);
        [[unroll]] for (uint j = 0u; j < MOMENTS; ++j) total[j] = 0.0;
        [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) total_color[c] = 0.0;
        float best = -1.0;
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) best = max(best, T[k]);
        if (!subgroupAll(best < 0.0)) {
            uint v = entry_splats[entry];
            Splat s = splats[v];
            FETCH_CHANNELS(f, features, v)
            // Slots that no splat of the batch touches are left out.
            uint slots = subgroupOr(touched_slots(s, corner));
            [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                if (!in_slots(slots, k)) continue;
                // llvmpipe ends loops that are not unrolled too early; its subgroups have at most 16 lanes.
                for (uint piece = 0u; piece < SUBGROUP; piece += PIECE) {
                    [[unroll]] for (uint j = 0u; j < PIECE; ++j) {
                        uint i = piece + j;
                        float start = subgroupShuffle(T[k], i);
                        if (start <= 0.0) continue;
                        float debt = subgroupShuffle(R[k], i);
                        vec2 offset = vec2(slot_corner(k) + pixel_of_lane(i));
                        float dx = corner.x + offset.x - s.mean.x, dy = corner.y + offset.y - s.mean.y;
                        float p = s.factor.x * dx + s.factor.y * dy;
                        float q = s.factor.z * dy;
                        float raw = s.opacity * exp2(-(p * p + q * q));
                        float alpha = min(ALPHA_MAX, raw);
                        alpha = alpha >= ALPHA_MIN && real ? alpha : 0.0;
                        float before = start * subgroupExclusiveMul(1.0 - alpha);
                        bool stop = alpha > 0.0 && before - alpha * before < TRANSMITTANCE_MIN;
                        uvec4 stops = subgroupBallot(stop);
                        bool stopped = any(notEqual(stops, uvec4(0u)));
                        uint first = stopped ? subgroupBallotFindLSB(stops) : SUBGROUP;
                        float w = lane < first || KEEP_LAST && lane == first ? alpha * before : 0.0;
                        float s_dot_g = 0.0, statistic_dot = 0.0;
                        [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) {
                            float gradient = subgroupShuffle(g[k * CHANNELS + c], i);
                            total_color[c] += w * gradient;
                            s_dot_g += f[c] * gradient;
                            if (STATISTIC_FLOATS > 0u && in_statistic(c)) statistic_dot += f[c] * gradient;
                        }
                        if (WEIGHTS > 0u) total_weight += w;
                        float after = debt - subgroupInclusiveAdd(w * s_dot_g);
                        float h = w > 0.0 && raw <= ALPHA_MAX
                            ? -0.69314718055994531 * alpha * (before * s_dot_g - after / (1.0 - alpha)) : 0.0;
                        float hp = h * p;
                        float hy = h * dy;
                        total[0] += h;
                        total[1] += hp;
                        total[2] += hp * p;
                        total[3] += hp * dy;
                        total[4] += hy;
                        total[5] += hy * dy;
                        float statistic_owed = 0.0;
                        if (STATISTIC_FLOATS > 0u) {
                            float statistic_after =
                                subgroupShuffle(statistic_R[k], i) - subgroupInclusiveAdd(w * statistic_dot);
                            float owed = statistic_after / (1.0 - alpha);
                            float of_statistic = w > 0.0 && raw <= ALPHA_MAX
                                ? -0.69314718055994531 * alpha * (before * statistic_dot - owed) : 0.0;
                            total_statistic += of_statistic * vec2(p, dy);
                            statistic_owed = subgroupShuffle(statistic_after, SUBGROUP - 1u);
                        }
                        // The pixel goes on from where the last lane left it, or stops for good.
                        float rest = subgroupShuffle(before - alpha * before, SUBGROUP - 1u);
                        float owed = subgroupShuffle(after, SUBGROUP - 1u);
                        if (lane == i) {
                            T[k] = stopped ? -1.0 : rest;
                            R[k] = owed;
                            if (STATISTIC_FLOATS > 0u) statistic_R[k] = statistic_owed;
                        }
                    }
                }
            }
        }
        if (real) {
            uint at = entry * GRADIENTS;
            [[unroll]] for (uint j = 0u; j < MOMENTS; ++j) entry_gradients[at + j] = total[j];
            [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) entry_gradients[at + MOMENTS + c] = total_color[c];
            if (WEIGHTS > 0u) entry_gradients[at + MOMENTS + CHANNELS] = total_weight;
            if (STATISTIC_FLOATS > 0u) {
                entry_gradients[at + MOMENTS + CHANNELS + WEIGHTS] = total_statistic.x;
                entry_gradients[at + MOMENTS + CHANNELS + WEIGHTS + 1u] = total_statistic.y;
            }
        }
    }
}

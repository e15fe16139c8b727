// Backward of blend with lanes as pixels, for blend_bwd and, where ATOMIC is defined, blend_bwd_atomic.
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"
#include "blend_bwd.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 8;
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(constant_id = 4) const uint CHANNELS = 3;
layout(constant_id = 5) const uint WEIGHTS = 0; // 1: also the sum of blending weights
layout(local_size_x_id = 0) in;
#include "channels.glsl"
#include "tile.glsl"
#include "sub_tiles.glsl"
#include "statistic.glsl"
#include "lane_sums.glsl"

const uint GRADIENTS = MOMENTS + CHANNELS + WEIGHTS + STATISTIC_FLOATS;
const uint PARTS = (GRADIENTS + SUBGROUP - 1u) / SUBGROUP;

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
IN(uint, features);
IN(float, grad_image);
IN(float, debt);
IN(float, statistic_debt); // the debt of the losses that enter the statistic
#ifdef ATOMIC
INOUT(float, splat_gradients); // [visible * GRADIENTS]
#else
OUT(float, entry_gradients); // [entries * GRADIENTS]
#endif

void main() {
    Camera camera = params.step.camera;
    Tile tile = this_tile(camera);
    if (tile.index >= camera.tiles.x * camera.tiles.y) return;
    uint begin = tile_ranges[2u * tile.index], end = tile_ranges[2u * tile.index + 1u];
    if (begin >= end) return;
    float px = float(tile.first.x) + 0.5;
    float py = float(tile.first.y) + 0.5;
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
    for (uint batch = begin; batch < end; batch += SUBGROUP) {
        uint count = min(SUBGROUP, end - batch);
        uint mine = min(batch + gl_SubgroupInvocationID, end - 1u);
        uint entry = sorted_entries[mine];
        float best = -1.0;
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) best = max(best, T[k]);
#ifdef ATOMIC
        if (subgroupAll(best < 0.0)) break;
#else
        if (subgroupAll(best < 0.0)) {
            // Once every pixel has stopped the rest of the entries still get their zeros.
            if (gl_SubgroupInvocationID < count) {
                [[unroll]] for (uint j = 0u; j < GRADIENTS; ++j) entry_gradients[entry * GRADIENTS + j] = 0.0;
            }
            continue;
        }
#endif
        uint v = entry_splats[entry];
        Splat s = splats[v];
        uint own_slots = touched_slots(s, vec2(tile.corner) + 0.5);
        FETCH_CHANNELS(f, features, v)
        for (uint i = 0u; i < count; ++i) {
            float mx = subgroupShuffle(s.mean.x, i), my = subgroupShuffle(s.mean.y, i);
            float u11 = subgroupShuffle(s.factor.x, i), u12 = subgroupShuffle(s.factor.y, i);
            float u22 = subgroupShuffle(s.factor.z, i), opacity = subgroupShuffle(s.opacity, i);
            float color[CHANNELS];
            [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) color[c] = subgroupShuffle(f[c], i);
            float sum[PARTS * SUBGROUP];
            [[unroll]] for (uint j = 0u; j < PARTS * SUBGROUP; ++j) sum[j] = 0.0;
#ifdef ATOMIC
            uint owner = subgroupShuffle(v, i);
#else
            uint owner = subgroupShuffle(entry, i);
#endif
            uint slots = subgroupShuffle(own_slots, i);
            [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                if (!in_slots(slots, k)) continue;
                vec2 offset = vec2(slot_corner(k));
                float dx = px + offset.x - mx, dy = py + offset.y - my;
                float p = u11 * dx + u12 * dy;
                float q = u22 * dy;
                float raw = opacity * exp2(-(p * p + q * q));
                float alpha = min(ALPHA_MAX, raw);
                alpha = alpha >= ALPHA_MIN && T[k] > 0.0 ? alpha : 0.0;
                float next = T[k] - alpha * T[k];
                bool stop = alpha > 0.0 && next < TRANSMITTANCE_MIN;
                float w = stop && !KEEP_LAST ? 0.0 : alpha * T[k];
                float s_dot_g = 0.0, statistic_dot = 0.0;
                [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) {
                    sum[MOMENTS + c] += w * g[k * CHANNELS + c];
                    s_dot_g += color[c] * g[k * CHANNELS + c];
                    if (STATISTIC_FLOATS > 0u && in_statistic(c)) statistic_dot += color[c] * g[k * CHANNELS + c];
                }
                if (WEIGHTS > 0u) sum[MOMENTS + CHANNELS] += w;
                R[k] -= w * s_dot_g;
                // -ln2 alpha dL/dalpha: zero where alpha is cut off, and where the pixel stops.
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
                if (STATISTIC_FLOATS > 0u) {
                    statistic_R[k] -= w * statistic_dot;
                    float owed = statistic_R[k] / (1.0 - alpha);
                    float of_statistic = w > 0.0 && raw <= ALPHA_MAX
                        ? -0.69314718055994531 * alpha * (T[k] * statistic_dot - owed) : 0.0;
                    sum[(MOMENTS + CHANNELS + WEIGHTS) % GRADIENTS] += of_statistic * p;
                    sum[(MOMENTS + CHANNELS + WEIGHTS + 1u) % GRADIENTS] += of_statistic * dy;
                }
                T[k] = stop ? -(KEEP_LAST ? next : T[k]) : next;
            }
            [[unroll]] for (uint part = 0u; part < PARTS; ++part) {
                float lane_sum[SUBGROUP];
                [[unroll]] for (uint j = 0u; j < SUBGROUP; ++j) lane_sum[j] = sum[part * SUBGROUP + j];
                LANE_SUMS_OF(lane_sum, GRADIENTS - part * SUBGROUP)
                uint j = part * SUBGROUP + lane_of_sum();
#ifdef ATOMIC
                if (j < GRADIENTS && lane_sum[0] != 0.0) atomicAdd(splat_gradients[owner * GRADIENTS + j], lane_sum[0]);
#else
                if (j < GRADIENTS) entry_gradients[owner * GRADIENTS + j] = lane_sum[0];
#endif
            }
        }
    }
}

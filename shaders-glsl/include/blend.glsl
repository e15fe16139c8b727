// Blends the splats of a tile front to back, for any number of channels. For blend and, where CHECKPOINTS is defined,
// blend_buckets.
//
// Views of few tiles have several subgroups a tile. Each fetches all entries, but visits only those that can show in its
// part. A pixel meets the same splats in the same order, whatever the part.
//
// alpha = min(0.99, opacity * exp(-power)); an alpha below 1/255 is skipped; a pixel stops before its transmittance would
// fall below 1e-4. The background goes behind the colors, which are the first three channels.
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 8;
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(constant_id = 4) const uint CHANNELS = 3;
layout(constant_id = 5) const bool HAS_COLORS = true;
layout(local_size_x_id = 0) in;
#define HAS_PARTS
#include "channels.glsl"
#include "tile.glsl"
#include "sub_tiles.glsl"
#include "next_lane.glsl"
#ifdef CHECKPOINTS
const uint PIXELS = TILE_WIDTH * TILE_HEIGHT;
#include "buckets.glsl"
#endif

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
IN(uint, features);
OUT(float, image);         // [pixels * CHANNELS]
OUT(float, transmittance); // [pixels]
#ifdef CHECKPOINTS
OUT(float, checkpoints);
OUT(uint, bucket_tiles);
#endif

void main() {
    Camera camera = params.step.camera;
    Tile tile = this_tile(camera);
    if (tile.index >= camera.tiles.x * camera.tiles.y) return;
    float px = float(tile.first.x) + 0.5;
    float py = float(tile.first.y) + 0.5;
    // Negative once a pixel has stopped: its final transmittance with the sign as the mark. Pixels outside of the view have
    // stopped from the start.
    float T[PER_LANE];
    float sum[PER_LANE * CHANNELS];
    ivec2 inside = ivec2(camera.size) - ivec2(tile.first);
    [[unroll]] for (uint k = 0u; k < PER_LANE; ++k)
        T[k] = all(lessThan(ivec2(slot_corner(k)), inside)) ? 1.0 : -1.0;
    [[unroll]] for (uint k = 0u; k < PER_LANE * CHANNELS; ++k) sum[k] = 0.0;
    uint begin = tile_ranges[2u * tile.index], end = tile_ranges[2u * tile.index + 1u];
#ifdef CHECKPOINTS
    uint reached = 0u; // buckets
#endif
    for (uint batch = begin; batch < end; batch += SUBGROUP) {
        float best = -1.0;
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) best = max(best, T[k]);
        if (subgroupAll(best < 0.0)) break;
#ifdef CHECKPOINTS
        if ((batch - begin) % BUCKET == 0u) {
            // The first bucket of a tile starts with nothing blended. A part that has stopped writes none.
            if (reached > 0u) {
                [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                    uvec2 pixel = part_corner(tile.part) + slot_corner(k) + pixel_of_lane(gl_SubgroupInvocationID);
                    uint at = checkpoint(begin, reached, pixel.y * TILE_WIDTH + pixel.x);
                    checkpoints[at] = T[k];
                    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c)
                        checkpoints[at + (1u + c) * PIXELS] = sum[k * CHANNELS + c];
                }
            }
            ++reached;
        }
#endif
        // Each lane fetches one splat; all lanes then see those that show in the part, in turn.
        uint mine = min(batch + gl_SubgroupInvocationID, end - 1u);
        uint v = entry_splats[sorted_entries[mine]];
        Splat s = splats[v];
        uint own_slots = touched_slots(s, vec2(tile.corner) + 0.5);
        FETCH_CHANNELS(f, features, v)
        bool there = batch + gl_SubgroupInvocationID < end;
        uvec4 hits = subgroupBallot(there && own_slots != 0u);
        while (any_lane(hits)) {
            uint i = next_lane(hits);
            float mx = subgroupShuffle(s.mean.x, i), my = subgroupShuffle(s.mean.y, i);
            float u11 = subgroupShuffle(s.factor.x, i), u12 = subgroupShuffle(s.factor.y, i);
            float u22 = subgroupShuffle(s.factor.z, i), opacity = subgroupShuffle(s.opacity, i);
            float color[CHANNELS];
            [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) color[c] = subgroupShuffle(f[c], i);
            uint slots = subgroupShuffle(own_slots, i);
            [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                if (!in_slots(slots, k)) continue;
                vec2 offset = vec2(slot_corner(k));
                float dx = px + offset.x - mx, dy = py + offset.y - my;
                float p = u11 * dx + u12 * dy;
                float q = u22 * dy;
                float alpha = min(ALPHA_MAX, opacity * exp2(-(p * p + q * q)));
                alpha = alpha >= ALPHA_MIN && T[k] > 0.0 ? alpha : 0.0;
                float next = T[k] - alpha * T[k];
                bool stop = alpha > 0.0 && next < TRANSMITTANCE_MIN;
                float w = stop && !KEEP_LAST ? 0.0 : alpha * T[k];
                [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) sum[k * CHANNELS + c] += w * color[c];
                T[k] = stop ? -(KEEP_LAST ? next : T[k]) : next;
            }
        }
    }
    [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
        // The pixel follows from its center, so the walk keeps only one of them in registers.
        uvec2 pixel = uvec2(px, py) + slot_corner(k);
        if (all(lessThan(pixel, camera.size))) {
            uint at = pixel.y * camera.size.x + pixel.x;
            float rest = abs(T[k]);
            transmittance[at] = rest;
            [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) {
                float back = HAS_COLORS && c < 3u ? rest * params.step.background[c % 3u] : 0.0;
                image[at * CHANNELS + c] = sum[k * CHANNELS + c] + back;
            }
        }
    }
#ifdef CHECKPOINTS
    for (uint b = gl_SubgroupInvocationID; b < bucket_count(begin, end); b += SUBGROUP) {
        uint mark = bucket_mark(first_bucket(begin, tile.index) + b, tile.part);
        bucket_tiles[mark] = tile.index | (b < reached ? 0u : UNREACHED);
    }
#endif
}

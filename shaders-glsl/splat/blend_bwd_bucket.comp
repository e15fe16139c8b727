// Backward of blend over buckets of a tile's entries: a subgroup takes one bucket, each lane owns a few of its splats.
//
// Pixels stream through the lanes: at round r, lane l has pixel r - l, and hands transmittance and debt on to lane l + 1.
// So every pixel meets the splats in order, sums stay in their lane, and a view of few tiles still fills a device. A bucket
// starts from the checkpoints of blend_buckets; pixels that have stopped before it are left out.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"
#include "blend_bwd.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(constant_id = 1) const uint PER_LANE = 8; // pixels of a tile by lanes
layout(constant_id = 2) const uint TILE_WIDTH = 16;
layout(constant_id = 3) const uint TILE_HEIGHT = 16;
layout(constant_id = 4) const uint CHANNELS = 3;
layout(constant_id = 5) const uint WEIGHTS = 0;
layout(constant_id = 6) const uint OWN = 2; // splats of a lane, neighbors in the tile's list
layout(local_size_x_id = 0) in;
const uint PIXELS = TILE_WIDTH * TILE_HEIGHT;
#include "channels.glsl"
#include "statistic.glsl"
#include "parts.glsl"
#include "buckets.glsl"

const uint GRADIENTS = MOMENTS + CHANNELS + WEIGHTS + STATISTIC_FLOATS;
const uint BATCH = OWN * SUBGROUP;
// Gradients of the image lie in shared memory if all of it then takes 16 KiB at most, as with tiles of 16 x 16.
const bool STAGED = 4u * PIXELS * (3u + STATISTIC_FLOATS + CHANNELS) <= 16384u;

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, tile_ranges);
IN(uint, sorted_entries);
IN(uint, entry_splats);
IN(Splat, splats);
IN(uint, features);
IN(float, grad_image);
IN(float, debt);
IN(float, statistic_debt); // the debt of the losses that enter the statistic
IN(float, checkpoints);
IN(uint, bucket_tiles);
OUT(float, entry_gradients);

// Pixels that have not stopped before the bucket, side by side.
shared vec2 state[PIXELS]; // transmittance and debt
shared float statistic_state[STATISTIC_FLOATS > 0u ? PIXELS : 1u];
shared float gradient[STAGED ? CHANNELS * PIXELS : 1u];
shared uint place[PIXELS]; // in the tile, by rows

void main() {
    Camera camera = params.step.camera;
    uint slot = folded_workgroup();
    if (bucket_mark(slot, 0u) >= bucket_tiles.length()) return;
    uint mark = bucket_tiles[bucket_mark(slot, 0u)];
    if (mark == NO_TILE) return;
    uint lane = gl_SubgroupInvocationID;
    uint tile = mark & ~UNREACHED;
    uint reached = uint((mark & UNREACHED) == 0u); // parts of the tile, a bit each
    [[unroll]] for (uint part = 1u; part < TILE_PARTS; ++part)
        reached |= uint((bucket_tiles[bucket_mark(slot, part)] & UNREACHED) == 0u) << part;
    uvec2 corner = uvec2(tile % camera.tiles.x, tile / camera.tiles.x) * uvec2(TILE_WIDTH, TILE_HEIGHT);
    uint begin = tile_ranges[2u * tile];
    uint bucket = slot - first_bucket(begin, tile);
    uint first = begin + bucket * BUCKET;
    uint end = min(first + BUCKET, tile_ranges[2u * tile + 1u]);
    uint pixels = 0u;
    if (reached != 0u) {
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
            uint here = k * SUBGROUP + lane;
            uvec2 in_tile = uvec2(here % TILE_WIDTH, here / TILE_WIDTH);
            uvec2 pixel = corner + in_tile;
            bool inside = all(lessThan(pixel, camera.size));
            if (TILE_PARTS > 1u) inside = inside && (reached >> part_of_pixel(in_tile) & 1u) != 0u;
            uint at = inside ? pixel.y * camera.size.x + pixel.x : 0u;
            uint before = bucket > 0u ? checkpoint(begin, bucket, here) : 0u;
            float T = bucket > 0u && inside ? checkpoints[before] : 1.0;
            bool walked = inside && T > 0.0;
            uvec4 all_walked = subgroupBallot(walked);
            uint to = pixels + subgroupBallotExclusiveBitCount(all_walked);
            pixels += subgroupBallotBitCount(all_walked);
            if (walked) {
                float R = debt[at];
                float statistic_R = STATISTIC_FLOATS > 0u ? statistic_debt[at] : 0.0;
                [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) {
                    float g = grad_image[at * CHANNELS + c];
                    if (STAGED) gradient[c * PIXELS + to] = g;
                    if (bucket > 0u) {
                        float paid = g * checkpoints[before + (1u + c) * PIXELS];
                        R -= paid;
                        if (STATISTIC_FLOATS > 0u && in_statistic(c)) statistic_R -= paid;
                    }
                }
                state[to] = vec2(T, R);
                if (STATISTIC_FLOATS > 0u) statistic_state[to] = statistic_R;
                place[to] = here;
            }
        }
        barrier();
    }
    vec2 base = vec2(corner) + 0.5;
    for (uint batch = first; batch < end; batch += BATCH) {
        Splat s[OWN];
        float f[OWN * CHANNELS];
        uint entry[OWN];
        float total[OWN * MOMENTS];
        float total_color[OWN * CHANNELS];
        float total_weight[OWN];
        vec2 total_statistic[OWN];
        [[unroll]] for (uint j = 0u; j < OWN * MOMENTS; ++j) total[j] = 0.0;
        [[unroll]] for (uint j = 0u; j < OWN * CHANNELS; ++j) total_color[j] = 0.0;
        [[unroll]] for (uint o = 0u; o < OWN; ++o) {
            total_weight[o] = 0.0;
            total_statistic[o] = vec2(0.0);
            entry[o] = sorted_entries[min(batch + lane * OWN + o, end - 1u)];
        }
        bool walked = false;
        for (uint p = lane; p < pixels; p += SUBGROUP) walked = walked || state[p].x > 0.0;
        if (subgroupAny(walked)) {
            [[unroll]] for (uint o = 0u; o < OWN; ++o) {
                uint v = entry_splats[entry[o]];
                s[o] = splats[v];
                // Lanes after the tile's last entry show nothing.
                if (batch + lane * OWN + o >= end) s[o].opacity = 0.0;
                FETCH_CHANNELS(fetched, features, v)
                [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) f[o * CHANNELS + c] = fetched[c];
            }
            float T = -1.0, R = 0.0, statistic_R = 0.0;
            uint previous = (lane + SUBGROUP - 1u) % SUBGROUP;
            for (uint r = 0u; r < pixels + SUBGROUP - 1u; ++r) {
                // The last lane writes a pixel's state SUBGROUP - 1 rounds after the first lane has read it.
                if (BUCKET > BATCH && r % (SUBGROUP / 2u) == 0u) subgroupBarrier();
                T = subgroupShuffle(T, previous);
                R = subgroupShuffle(R, previous);
                if (STATISTIC_FLOATS > 0u) statistic_R = subgroupShuffle(statistic_R, previous);
                uint i = r - lane; // wraps in lanes that the first pixel has not reached
                bool there = i < pixels;
                uint at = there ? i : 0u;
                if (lane == 0u) {
                    T = state[at].x;
                    R = state[at].y;
                    if (STATISTIC_FLOATS > 0u) statistic_R = statistic_state[at];
                }
                if (!there) T = -1.0;
                uint here = place[at];
                float px = base.x + float(here % TILE_WIDTH), py = base.y + float(here / TILE_WIDTH);
                float g[CHANNELS];
                [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) g[c] = 0.0;
                if (STAGED) {
                    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) g[c] = gradient[c * PIXELS + at];
                } else if (there) {
                    uvec2 pixel = corner + uvec2(here % TILE_WIDTH, here / TILE_WIDTH);
                    uint from = (pixel.y * camera.size.x + pixel.x) * CHANNELS;
                    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) g[c] = grad_image[from + c];
                }
                [[unroll]] for (uint o = 0u; o < OWN; ++o) {
                    float dx = px - s[o].mean.x;
                    float dy = py - s[o].mean.y;
                    float p = s[o].factor.x * dx + s[o].factor.y * dy;
                    float q = s[o].factor.z * dy;
                    float raw = s[o].opacity * exp2(-(p * p + q * q));
                    float alpha = min(ALPHA_MAX, raw);
                    alpha = alpha >= ALPHA_MIN && T > 0.0 ? alpha : 0.0;
                    float next = T - alpha * T;
                    bool stop = alpha > 0.0 && next < TRANSMITTANCE_MIN;
                    float w = stop && !KEEP_LAST ? 0.0 : alpha * T;
                    float s_dot_g = 0.0, statistic_dot = 0.0;
                    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) {
                        total_color[o * CHANNELS + c] += w * g[c];
                        s_dot_g += f[o * CHANNELS + c] * g[c];
                        if (STATISTIC_FLOATS > 0u && in_statistic(c)) statistic_dot += f[o * CHANNELS + c] * g[c];
                    }
                    if (WEIGHTS > 0u) total_weight[o] += w;
                    R -= w * s_dot_g;
                    // -ln2 alpha dL/dalpha: zero where alpha is cut off, and where the pixel stops.
                    bool moves = w > 0.0 && raw <= ALPHA_MAX;
                    float h = moves ? -0.69314718055994531 * alpha * (T * s_dot_g - R / (1.0 - alpha)) : 0.0;
                    float hp = h * p;
                    float hy = h * dy;
                    total[o * MOMENTS] += h;
                    total[o * MOMENTS + 1u] += hp;
                    total[o * MOMENTS + 2u] += hp * p;
                    total[o * MOMENTS + 3u] += hp * dy;
                    total[o * MOMENTS + 4u] += hy;
                    total[o * MOMENTS + 5u] += hy * dy;
                    if (STATISTIC_FLOATS > 0u) {
                        statistic_R -= w * statistic_dot;
                        float owed = statistic_R / (1.0 - alpha);
                        float of_statistic =
                            moves ? -0.69314718055994531 * alpha * (T * statistic_dot - owed) : 0.0;
                        total_statistic[o] += of_statistic * vec2(p, dy);
                    }
                    T = stop ? -1.0 : next;
                }
                // The next batch goes on from where the last lane left the pixel.
                if (BUCKET > BATCH && there && lane == SUBGROUP - 1u) {
                    state[at] = vec2(T, R);
                    if (STATISTIC_FLOATS > 0u) statistic_state[at] = statistic_R;
                }
            }
        }
        if (BUCKET > BATCH) barrier();
        [[unroll]] for (uint o = 0u; o < OWN; ++o) {
            if (batch + lane * OWN + o >= end) continue;
            uint row = entry[o] * GRADIENTS;
            [[unroll]] for (uint j = 0u; j < MOMENTS; ++j) entry_gradients[row + j] = total[o * MOMENTS + j];
            [[unroll]] for (uint c = 0u; c < CHANNELS; ++c)
                entry_gradients[row + MOMENTS + c] = total_color[o * CHANNELS + c];
            if (WEIGHTS > 0u) entry_gradients[row + MOMENTS + CHANNELS] = total_weight[o];
            if (STATISTIC_FLOATS > 0u) {
                entry_gradients[row + MOMENTS + CHANNELS + WEIGHTS] = total_statistic[o].x;
                entry_gradients[row + MOMENTS + CHANNELS + WEIGHTS + 1u] = total_statistic[o].y;
            }
        }
    }
}

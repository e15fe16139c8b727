// Writes one entry for each tile that a splat touches, splats in depth order.
//
// A stable sort by tile then keeps each tile's entries in depth order, with keys as short as the number of tiles.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "splat.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint TILE_WIDTH = 16;
layout(constant_id = 2) const uint TILE_HEIGHT = 16;
layout(constant_id = 3) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
#include "large_splats.glsl"
#include "large_tiles.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(Work, entries);       // count 0 after an overflow
IN(uint, depth_order);
IN(uint, entry_offsets); // by depth rank
IN(uint, tile_counts);   // by splat
IN(Splat, splats);
OUT(uint, tile_keys);
OUT(uint, entry_splats); // by entry
OUT(uint, entry_starts); // by splat: its first entry

// Writes the entries of this lane's splat from `at` on. Returns the place of the next entry.
uint write_own(Footprint f, uint v, uint at, uint end) {
    Splat s = f.splat;
    float limit = f.limit;
    PixelBox box = f.box;
    int width = int(TILE_WIDTH), height = int(TILE_HEIGHT);
    for (int ty = box.low.y / height; ty <= box.high.y / height; ++ty) {
        ivec2 span = splat_tile_span(s, limit, box, ty * height, ty * height + height - 1, width);
        for (int tx = span.x; tx <= span.y; ++tx) {
            bool touched = tx == span.x || tx == span.y ||
                           splat_touches(s, limit, tx * width, tx * width + width - 1, max(ty * height, box.low.y),
                                         min(ty * height + height - 1, box.high.y));
            if (touched && at < end) {
                tile_keys[at] = uint(ty) * params.step.camera.tiles.x + uint(tx);
                entry_splats[at] = v;
                ++at;
            }
        }
    }
    return at;
}

// As `write_own` for the large splats of all lanes, one after the other.
uint write_large(bool large, Footprint own, uint v, uint at, uint end) {
    uvec4 votes = subgroupBallot(large);
    while (any(notEqual(votes, uvec4(0u)))) {
        uint lane = next_large(votes);
        Footprint f = footprint_of_lane(own, lane);
        uint splat = subgroupShuffle(v, lane), next = subgroupShuffle(at, lane), stop = subgroupShuffle(end, lane);
        WALK_TILES(f, {
            uvec4 found = subgroupBallot(touched);
            uint place = next + subgroupBallotExclusiveBitCount(found);
            if (touched && place < stop) {
                tile_keys[place] = uint(ty) * params.step.camera.tiles.x + uint(tx);
                entry_splats[place] = splat;
            }
            next += subgroupBallotBitCount(found);
        })
        if (lane == gl_SubgroupInvocationID) at = min(next, stop);
    }
    return at;
}

void main() {
    uint rank = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    bool there = rank < visible[0].count;
    uint v = there ? depth_order[rank] : 0u;
    uint at = there ? entry_offsets[rank] : 0u;
    if (there) entry_starts[v] = at;
    if (entries[0].count == 0u) return;
    uint end = there ? at + tile_counts[v] : at;
    Camera camera = params.step.camera;
    Footprint f = Footprint(Splat(vec2(0.0), vec3(1.0, 0.0, 1.0), 0.0), 0.0, EMPTY_BOX);
    // A splat without tiles may have any record.
    if (end > at) {
        f.splat = splats[v];
        f.limit = exponent_limit(f.splat);
        f.box = splat_box(f.splat, f.limit, camera.size);
    }
    bool large = is_large(f);
    if (end > at && !large) at = write_own(f, v, at, end);
    at = write_large(large, f, v, at, end);
    // The count and these loops run the same `precise` arithmetic. Should a driver still make them differ, the entries
    // left over go to a tile that does not exist rather than hold garbage.
    for (; at < end; ++at) {
        tile_keys[at] = camera.tiles.x * camera.tiles.y;
        entry_splats[at] = v;
    }
}

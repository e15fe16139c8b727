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
layout(local_size_x_id = 0) in;

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

void main() {
    uint rank = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (rank >= visible[0].count) return;
    uint v = depth_order[rank];
    uint at = entry_offsets[rank];
    entry_starts[v] = at;
    if (entries[0].count == 0u) return;
    uint end = at + tile_counts[v];
    Camera camera = params.step.camera;
    Splat s = splats[v];
    float limit = exponent_limit(s);
    PixelBox box = splat_box(s, limit, camera.size);
    int width = int(TILE_WIDTH), height = int(TILE_HEIGHT);
    for (int ty = box.low.y / height; ty <= box.high.y / height; ++ty) {
        ivec2 span = splat_tile_span(s, limit, box, ty * height, ty * height + height - 1, width);
        for (int tx = span.x; tx <= span.y; ++tx) {
            bool touched = tx == span.x || tx == span.y ||
                           splat_touches(s, limit, tx * width, tx * width + width - 1, max(ty * height, box.low.y),
                                         min(ty * height + height - 1, box.high.y));
            if (touched && at < end) {
                tile_keys[at] = uint(ty) * camera.tiles.x + uint(tx);
                entry_splats[at] = v;
                ++at;
            }
        }
    }
    // The count and this loop run the same `precise` arithmetic. Should a driver still make them differ, the entries
    // left over go to a tile that does not exist rather than hold garbage.
    for (; at < end; ++at) {
        tile_keys[at] = camera.tiles.x * camera.tiles.y;
        entry_splats[at] = v;
    }
}

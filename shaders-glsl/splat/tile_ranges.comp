// First and one-past-last entry of each tile, from the sorted keys. Tiles without entries keep the zeros they had.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, entries);
IN(uint, tile_keys);
OUT(uint, tile_ranges);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uint count = entries[0].count;
    if (i >= count) return;
    uint key = tile_keys[i];
    if (2u * key + 1u >= tile_ranges.length()) return;
    if (i == 0u || tile_keys[i - 1u] != key) tile_ranges[2u * key] = i;
    if (i + 1u == count || tile_keys[i + 1u] != key) tile_ranges[2u * key + 1u] = i + 1u;
}

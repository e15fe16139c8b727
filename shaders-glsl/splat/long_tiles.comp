// Detects tiles with more entries than one dispatch may process; writes group counts of the additional dispatches, or
// zeros.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SHORT = 0; // entries
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint tiles; uvec3 groups; } push;

IN(uint, tile_ranges);
OUT(uint, arguments);

shared uint found;

void main() {
    if (gl_LocalInvocationID.x == 0u) found = 0u;
    barrier();
    bool any_long = false;
    for (uint tile = gl_LocalInvocationID.x; tile < push.tiles; tile += WORKGROUP) {
        any_long = any_long || tile_ranges[2u * tile + 1u] - tile_ranges[2u * tile] > SHORT;
    }
    if (any_long) atomicOr(found, 1u);
    barrier();
    if (gl_LocalInvocationID.x != 0u) return;
    uvec3 groups = found != 0u ? push.groups : uvec3(0u);
    arguments[0] = groups.x;
    arguments[1] = groups.y;
    arguments[2] = groups.z;
}

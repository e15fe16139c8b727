// Exclusive prefix sums along rows of block sums, in place, and the rows' totals: the middle third of reduce-then-scan
// and of each pass of the radix sort. One workgroup a row. Sums that would pass 0xFFFFFFFF stay there.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint ITEMS = 4; // 16 at most
layout(local_size_x_id = 0) in;

// `block`: elements behind each sum; `stride`: words from row to row.
layout(push_constant, scalar) uniform Push { uint limit; uint block; uint stride; } push;

#include "../prim/count.glsl"
#include "../prim/group_scan.glsl"
INOUT(uint, sums);
OUT(uint, totals); // by row

// A sum of many numbers below 2^32, of their low and high halves, joined.
uint join(uvec2 halves) {
    uint high = halves.y + (halves.x >> 16);
    return high > 0xFFFFu ? 0xFFFFFFFFu : high << 16 | (halves.x & 0xFFFFu);
}

void main() {
    uint count = element_count();
    uint columns = count / push.block + uint(count % push.block != 0u);
    uint row = folded_workgroup();
    uint carry = 0u;
    for (uint start = 0u; start < columns; start += WORKGROUP * ITEMS) {
        uint first = start + group_rank() * ITEMS;
        uint values[ITEMS];
        uint sum = 0u;
        [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
            values[k] = first + k < columns ? sums[row * push.stride + first + k] : 0u;
            sum = add_saturating(sum, values[k]);
        }
        uvec2 total;
        uint prefix = add_saturating(carry, join(group_exclusive_sum(uvec2(sum & 0xFFFFu, sum >> 16), total)));
        [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
            if (first + k < columns) sums[row * push.stride + first + k] = prefix;
            prefix = add_saturating(prefix, values[k]);
        }
        carry = add_saturating(carry, join(total));
    }
    if (gl_LocalInvocationID.x == 0u) totals[row] = carry;
}

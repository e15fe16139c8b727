// As radix_scatter, with one subgroup a workgroup that writes elements directly to their places. For devices with small
// subgroups and expensive barriers: CPUs.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint SUBGROUP = 8; // also the workgroup
layout(constant_id = 1) const uint ITEMS = 256;
layout(constant_id = 2) const uint BITS = 8;
layout(constant_id = 3) const bool IOTA = false;      // the values are the positions
layout(constant_id = 4) const bool WRITE_KEYS = true; // whether a later pass reads them
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint limit; uint shift; uint stride; } push;

#include "../prim/count.glsl"
#include "../prim/radix.glsl"
IN(uint, totals); // by digit
IN(uint, counts); // by digit, `stride` words each, then by block: in all blocks before it
IN(uint, keys);
IN(uint, values); // not read for IOTA
OUT(uint, keys_sorted);
OUT(uint, values_sorted);

shared uint next[BINS]; // where the next element with a digit goes

void main() {
    uint count = element_count();
    uint block = folded_workgroup();
    uint first = block * SUBGROUP * ITEMS + gl_SubgroupInvocationID;
    if (block * SUBGROUP * ITEMS >= count) return;

    uint carry = 0u;
    for (uint start = 0u; start < BINS; start += SUBGROUP) {
        uint digit = start + gl_SubgroupInvocationID;
        uint total = digit < BINS ? totals[digit] : 0u;
        uint before = carry + subgroupExclusiveAdd(total);
        carry = subgroupBroadcast(before + total, SUBGROUP - 1u);
        if (digit < BINS) next[digit] = before + counts[digit * push.stride + block];
    }
    subgroupBarrier();

    for (uint k = 0u; k < ITEMS; ++k) {
        uint i = first + k * SUBGROUP;
        bool valid = i < count;
        uint key = valid ? keys[i] : 0u;
        uint digit = digit_of(key);
        Peers peers = find_peers(digit, valid);
        uint target = next[digit] + peers.before;
        subgroupBarrier();
        if (valid) {
            if (peers.last == gl_SubgroupInvocationID) next[digit] = target + 1u;
            if (WRITE_KEYS) keys_sorted[target] = key;
            values_sorted[target] = IOTA ? i : values[i];
        }
        subgroupBarrier();
    }
}

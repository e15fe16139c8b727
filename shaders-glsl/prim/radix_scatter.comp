// Moves each element of a block to its place among all with its digit: the last third of a pass of the radix sort.
//
// Each subgroup has a run of SUBGROUP * ITEMS elements and its own digit counters, so the order within a run, between runs
// and between blocks is preserved. Elements are ordered in shared memory first, so that stores are contiguous for each
// digit. Shared memory is used twice: for counters and their sums, then for the elements.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint ITEMS = 16;
layout(constant_id = 3) const uint BITS = 8;
layout(constant_id = 4) const bool IOTA = false;      // the values are the positions
layout(constant_id = 5) const bool WRITE_KEYS = true; // whether a later pass reads them
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

// Two counters a word: 16 bits are enough for a block.
const uint PAIRS = (BINS + 1u) / 2u;
const uint BLOCK = WORKGROUP * ITEMS;
const uint COUNTERS = WORKGROUP / SUBGROUP * PAIRS;
const uint STARTS = COUNTERS;
const uint SUMS = STARTS + 2u * PAIRS;
const uint COUNTED = SUMS + 2u * (WORKGROUP / SUBGROUP);
const uint POOL = COUNTED > BLOCK ? COUNTED : BLOCK;

// First the counters by subgroup and digit; from STARTS the number of each digit in the block, then its first position in
// the block; from SUMS the sums of the scan. Then the elements in their new order.
shared uint pool[POOL];
shared uint shifts[BINS]; // by digit: from a position in the block to one in the output

#define GROUP_SCAN_STORAGE
void store_group_sum(uint subgroup, uvec2 sum) {
    pool[SUMS + 2u * subgroup] = sum.x;
    pool[SUMS + 2u * subgroup + 1u] = sum.y;
}
uvec2 load_group_sum(uint subgroup) { return uvec2(pool[SUMS + 2u * subgroup], pool[SUMS + 2u * subgroup + 1u]); }
#include "../prim/group_scan.glsl"

uint half_of(uint word, uint digit) { return word >> (digit % 2u * 16u) & 0xFFFFu; }

void main() {
    uint count = element_count();
    uint block = folded_workgroup();
    if (block * BLOCK >= count) return;
    uint block_size = min(count - block * BLOCK, BLOCK);
    uint first = block * BLOCK + gl_SubgroupID * SUBGROUP * ITEMS + gl_SubgroupInvocationID;
    for (uint i = gl_LocalInvocationID.x; i < COUNTERS; i += WORKGROUP) pool[i] = 0u;

    uint own[ITEMS];
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint i = first + k * SUBGROUP;
        own[k] = i < count ? keys[i] : 0u;
    }
    barrier();

    // Position among the elements of its digit in the subgroup's run.
    uint places[ITEMS];
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        bool valid = first + k * SUBGROUP < count;
        uint digit = digit_of(own[k]);
        Peers peers = find_peers(digit, valid);
        uint word = gl_SubgroupID * PAIRS + digit / 2u;
        places[k] = half_of(pool[word], digit) + peers.before;
        subgroupBarrier();
        // Atomic because the lane with the other digit of the word adds to it, too.
        if (valid && peers.last == gl_SubgroupInvocationID) {
            atomicAdd(pool[word], (peers.before + 1u) << (digit % 2u * 16u));
        }
        subgroupBarrier();
    }
    barrier();

    // Counters become sums over the subgroups before, and the block's own.
    for (uint pair = gl_LocalInvocationID.x; pair < PAIRS; pair += WORKGROUP) {
        uint sum = 0u;
        for (uint s = 0u; s < SUBGROUPS; ++s) {
            uint added = pool[s * PAIRS + pair];
            pool[s * PAIRS + pair] = sum;
            sum += added;
        }
        pool[STARTS + 2u * pair] = sum & 0xFFFFu;
        pool[STARTS + 2u * pair + 1u] = sum >> 16u;
    }
    barrier();
    uvec2 carry = uvec2(0u);
    for (uint start = 0u; start < BINS; start += WORKGROUP) {
        uint digit = start + group_rank();
        uvec2 here = uvec2(0u); // everywhere, in this block
        if (digit < BINS) here = uvec2(totals[digit], pool[STARTS + digit]);
        uvec2 all;
        uvec2 before = carry + group_exclusive_sum(here, all);
        carry += all;
        if (digit < BINS) {
            pool[STARTS + digit] = before.y;
            shifts[digit] = before.x + counts[digit * push.stride + block] - before.y;
        }
    }
    barrier();

    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint digit = digit_of(own[k]);
        places[k] += half_of(pool[gl_SubgroupID * PAIRS + digit / 2u], digit) + pool[STARTS + digit];
    }
    barrier();
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        if (first + k * SUBGROUP < count) pool[places[k]] = own[k];
    }
    barrier();
    uint targets[ITEMS];
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint i = k * WORKGROUP + gl_LocalInvocationID.x;
        targets[k] = 0u;
        if (i < block_size) {
            uint key = pool[i];
            targets[k] = shifts[digit_of(key)] + i;
            if (WRITE_KEYS) keys_sorted[targets[k]] = key;
        }
    }
    barrier();
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint i = first + k * SUBGROUP;
        if (i < count) pool[places[k]] = IOTA ? i : values[i];
    }
    barrier();
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint i = k * WORKGROUP + gl_LocalInvocationID.x;
        if (i < block_size) values_sorted[targets[k]] = pool[i];
    }
}

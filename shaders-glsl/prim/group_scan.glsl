// Exclusive sums over the workgroup, of two numbers at once. Needs WORKGROUP, a multiple of SUBGROUP, at which the
// pipeline really runs.
const uint SUBGROUPS = WORKGROUP / SUBGROUP;

// A kernel that is short of shared memory defines GROUP_SCAN_STORAGE, and the two functions on memory of its own.
#ifndef GROUP_SCAN_STORAGE
shared uvec2 group_scan_sums[SUBGROUPS];
void store_group_sum(uint subgroup, uvec2 sum) { group_scan_sums[subgroup] = sum; }
uvec2 load_group_sum(uint subgroup) { return group_scan_sums[subgroup]; }
#endif

// Of all invocations before this one, in the order of (gl_SubgroupID, gl_SubgroupInvocationID). Uniform control flow.
uvec2 group_exclusive_sum(uvec2 value, out uvec2 total) {
    uvec2 before = subgroupExclusiveAdd(value);
    total = subgroupBroadcast(before + value, SUBGROUP - 1u);
    if (SUBGROUPS > 1u) {
        if (subgroupElect()) store_group_sum(gl_SubgroupID, total);
        barrier();
        total = uvec2(0u);
        for (uint s = 0u; s < SUBGROUPS; ++s) {
            if (s == gl_SubgroupID) before += total;
            total += load_group_sum(s);
        }
        barrier(); // the next call overwrites the sums
    }
    return before;
}

// Position in that order.
uint group_rank() { return gl_SubgroupID * SUBGROUP + gl_SubgroupInvocationID; }

uint add_saturating(uint a, uint b) { return min(a, ~b) + b; }

// Exclusive prefix sums of a block of WORKGROUP * ITEMS elements, from the prefix sum of the blocks before it. Each
// subgroup has a run of SUBGROUP * ITEMS elements, so that loads and stores are contiguous; the kernel says where.
const uint SUBGROUPS = WORKGROUP / SUBGROUP;

shared uint subgroup_sums[SUBGROUPS];

uint add_saturating(uint a, uint b) { return min(a, ~b) + b; }

void main() {
    uint count = element_count();
    uint block = folded_workgroup();
    if (block * WORKGROUP * ITEMS >= count) return;
    uint first = (block * SUBGROUPS + gl_SubgroupID) * SUBGROUP * ITEMS + gl_SubgroupInvocationID;
    uint before = sums[block];
    uint sum = 0u;
    if (SUBGROUPS == 1u) {
        // Nobody to wait for: nothing is held in registers, and ITEMS may be large.
        for (uint k = 0u; k < ITEMS; ++k) {
            uint i = first + k * SUBGROUP;
            uint value = i < count ? source[i] : 0u;
            uint prefix = sum + subgroupExclusiveAdd(value);
            if (i < count) target[i] = add_saturating(before, prefix);
            sum = subgroupBroadcast(prefix + value, SUBGROUP - 1u);
        }
        return;
    }
    uint prefixes[ITEMS];
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint i = first + k * SUBGROUP;
        prefixes[k] = i < count ? source[i] : 0u;
    }
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint value = prefixes[k];
        prefixes[k] = sum + subgroupExclusiveAdd(value);
        sum = subgroupBroadcast(prefixes[k] + value, SUBGROUP - 1u);
    }
    if (subgroupElect()) subgroup_sums[gl_SubgroupID] = sum;
    barrier();
    uint earlier = 0u;
    for (uint s = 0u; s < gl_SubgroupID; ++s) earlier += subgroup_sums[s];
    [[unroll]] for (uint k = 0u; k < ITEMS; ++k) {
        uint i = first + k * SUBGROUP;
        if (i < count) target[i] = add_saturating(before, earlier + prefixes[k]);
    }
}

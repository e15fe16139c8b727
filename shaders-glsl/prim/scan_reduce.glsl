// Sum of each block of WORKGROUP * ITEMS elements; the kernel says how an element is loaded.
shared uint subgroup_sums[WORKGROUP / SUBGROUP];

void main() {
    uint count = element_count();
    uint block = folded_workgroup();
    uint first = block * WORKGROUP * ITEMS;
    if (first >= count) return;
    uint end = min(first + WORKGROUP * ITEMS, count);
    uint sum = 0u;
    for (uint k = 0u; k < ITEMS; ++k) {
        uint i = first + k * WORKGROUP + gl_LocalInvocationID.x;
        if (i < end) sum += load(i);
    }
    sum = subgroupAdd(sum);
    if (WORKGROUP > SUBGROUP) {
        if (subgroupElect()) subgroup_sums[gl_SubgroupID] = sum;
        barrier();
        sum = 0u;
        for (uint s = 0u; s < WORKGROUP / SUBGROUP; ++s) sum += subgroup_sums[s];
    }
    if (gl_LocalInvocationID.x == 0u) sums[block] = sum;
}

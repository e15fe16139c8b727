// Sum over the workgroup in an order that does not change from run to run on a device.
//
// Needs a constant WORKGROUP and SUM_T, the type of the addends. Subgroups have at least 8 invocations; the engine rejects
// narrower ones.

shared SUM_T group_sums[(WORKGROUP + 7u) / 8u];

// The result is the first invocation's; call it once, from uniform control flow.
SUM_T group_sum(SUM_T value) {
    SUM_T sum = subgroupAdd(value);
    if (subgroupElect()) group_sums[gl_SubgroupID] = sum;
    barrier();
    SUM_T total = SUM_T(0.0);
    if (gl_LocalInvocationID.x == 0u) {
        for (uint i = 0u; i < gl_NumSubgroups; i++) total += group_sums[i];
    }
    return total;
}

// Adds up the words of each workgroup of 128, with one planted fault by its number.
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint FAULT = 0; // 0: none

layout(scalar) readonly buffer source_block { uint source[]; };
layout(scalar) buffer target_block { uint target[]; };

shared uint sums[128];
shared uint swapped[128];

void main() {
    uint i = gl_LocalInvocationID.x, at = gl_GlobalInvocationID.x, lane = gl_SubgroupInvocationID;
    uint sum = source[at];
    // 1: a wrong distance.
    for (uint d = 1u; d < gl_SubgroupSize; d *= 2u) sum += subgroupShuffleXor(sum, FAULT == 1u && d == 2u ? 1u : d);
    // 2: a sum that nobody writes.
    if (subgroupElect() && (FAULT != 2u || gl_SubgroupID > 0u)) sums[gl_SubgroupID] = sum;
    // 3: no barrier. 4: one that a subgroup skips. 5: one that lanes skip.
    if (FAULT == 4u) {
        if (gl_SubgroupID > 0u) barrier();
    } else if (FAULT == 5u) {
        if (lane != 3u) barrier();
    } else if (FAULT != 3u) {
        barrier();
    }
    uint total = 0u;
    for (uint s = 0u; FAULT != 4u && s < gl_NumSubgroups; s++) total += sums[s];
    // 6: a lane that does not take part.
    if (lane % 2u == 0u) total += subgroupShuffle(0u, FAULT == 6u ? lane + 1u : lane);
    // 7: an index past the end of a buffer. 8: one past the end of an array.
    if (FAULT == 7u) total += source[at + 128u * gl_NumWorkGroups.x];
    if (FAULT == 8u) total += sums[i + 64u];
    // 9: lanes of a subgroup that exchange words without a barrier.
    swapped[i] = total;
    if (FAULT != 9u) subgroupBarrier();
    total = swapped[i ^ 1u];
    // 10: a division by zero. 11: a loop without an end.
    if (FAULT == 10u) total /= source[at] - source[at];
    if (FAULT == 11u) while (source[at] < 1000000u) total++;
    // 12: workgroups that write one word. 13: lanes that write one word. 14: a read beside atomics.
    target[FAULT == 12u ? i : FAULT == 13u ? at / 2u : at] = total;
    if (FAULT == 14u) {
        atomicAdd(target[0], 1u);
        total = target[0];
    }
    // 15: a broadcast from several lanes. 16: a negative float as an unsigned integer.
    if (FAULT == 15u) target[at] = subgroupShuffle(total, 0u) + subgroupBroadcast(total, lane / 2u);
    if (FAULT == 16u) target[at] = uint(-2.0 * float(sum + 1u));
}

// Four words for each invocation of one workgroup: the subgroup size, how many subgroups there are, the invocation's place
// by subgroups, and how many lanes of its subgroup run.
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require

layout(local_size_x = 128) in;

layout(scalar) writeonly buffer to_block { uint to[]; };

void main() {
    uint at = 4u * gl_LocalInvocationID.x;
    to[at] = gl_SubgroupSize;
    to[at + 1u] = gl_NumSubgroups;
    to[at + 2u] = gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
    to[at + 3u] = subgroupBallotBitCount(subgroupBallot(true));
}

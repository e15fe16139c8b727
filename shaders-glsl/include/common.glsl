// Prelude of every kernel: extensions, buffer declarations, index of the invocation in a folded grid.
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_vote : require

#define IN(T, name) layout(scalar) restrict readonly buffer name##_block { T name[]; }
#define OUT(T, name) layout(scalar) restrict writeonly buffer name##_block { T name[]; }
#define INOUT(T, name) layout(scalar) restrict buffer name##_block { T name[]; }

// Grids wider than 65535 workgroups are folded into y.
uint folded_workgroup() { return gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x; }

// Makes a uniform that decides a branch appear to depend on the workgroup. Otherwise lavapipe bakes the values of uniforms
// that alone decide branches into the kernel, and recompiles it at every dispatch, which costs more than the dispatch and is
// never freed. (The third index of a workgroup is far below 2^31.)
uint by_workgroup(uint uniform_value) { return uniform_value + (gl_WorkGroupID.z & 0x80000000u); }

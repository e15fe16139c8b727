// What every kernel starts from: extensions, buffer declarations, index of the invocation in a folded grid.
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

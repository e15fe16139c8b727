// As scan_down, over its own input: a binding of its own, because two that overlap may not be written.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint ITEMS = 16;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint limit; } push;

#include "../prim/count.glsl"
IN(uint, sums); // by block: of all blocks before it
INOUT(uint, target);

#define source target
#include "../prim/scan_down.glsl"

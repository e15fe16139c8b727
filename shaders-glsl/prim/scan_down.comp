// Prefix sums within each block: the last third of reduce-then-scan.
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
IN(uint, source);
OUT(uint, target);

#include "../prim/scan_down.glsl"

// As scan_reduce, and leaves the elements where they will be scanned in place: gathered by an index, so that
// the random access happens once.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint ITEMS = 16;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint limit; } push;

#include "../prim/count.glsl"
IN(uint, source);
IN(uint, index);
OUT(uint, target);
OUT(uint, sums); // by block

uint load(uint i) {
    uint value = source[index[i]];
    target[i] = value;
    return value;
}

#include "../prim/scan_reduce.glsl"

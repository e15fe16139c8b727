// Converts a count on the GPU to Work records, one for each group size.
//
// A count beyond the capacity becomes 0, so that the rest of the frame does nothing, and raises a flag.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(local_size_x = 4) in;

layout(push_constant, scalar) uniform Push { uvec4 group_sizes; uint capacity; uint flag; } push;

IN(uint, source);  // the count, 0xFFFFFFFF for anything beyond
OUT(Work, works);  // one for each group size
OUT(uint, required); // the count before the check against capacity
INOUT(uint, flags);

void main() {
    uint i = gl_LocalInvocationID.x;
    uint count = source[0];
    bool fits = count <= push.capacity;
    works[i] = work_for(fits ? count : 0u, push.group_sizes[i]);
    if (i != 0u) return;
    required[0] = count;
    if (!fits) atomicOr(flags[0], push.flag);
}

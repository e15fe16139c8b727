// A Work record of the same count for another group size.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(local_size_x = 1) in;

layout(push_constant, scalar) uniform Push { uint group_size; } push;

IN(Work, work);
OUT(Work, regrouped);

void main() { regrouped[0] = work_for(work[0].count, push.group_size); }

// Writes a word of `to` for each invocation: how many there are, the group counts say.
#version 460
#include "words.glsl"

IN(from);
OUT(to);

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < uint(to.length())) to[i] = mixed(from[i % uint(from.length())], push.seed + gl_NumWorkGroups.x);
}

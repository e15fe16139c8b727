// Group counts of a conditional pass: zero if a word is zero; otherwise constants or counts from an earlier pass.
#version 460
#include "common.glsl"

layout(local_size_x = 1) in;

layout(push_constant, scalar) uniform Push { uvec3 groups; uint found; uint word_at; uint counts_at; } push;

IN(uint, word);
IN(uint, counts);
OUT(uint, arguments);

void main() {
    uvec3 groups = push.groups;
    if (push.found != 0u) {
        uint at = push.counts_at;
        groups = uvec3(counts[at], counts[at + 1u], counts[at + 2u]);
    }
    if (word[push.word_at] == 0u) groups = uvec3(0u);
    arguments[0] = groups.x;
    arguments[1] = groups.y;
    arguments[2] = groups.z;
}

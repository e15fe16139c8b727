// Writes group counts: none to three groups, as `from` has it.
#version 460
#include "words.glsl"

IN(from);
OUT(groups);

void main() {
    if (gl_GlobalInvocationID.x == 0u) {
        groups[0] = mixed(from[0], push.seed) & 3u;
        groups[1] = 1u;
        groups[2] = 1u;
    }
}

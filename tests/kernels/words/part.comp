// Writes some of the words of `to` and leaves the others as they are.
#version 460
#include "words.glsl"

IN(from);
OUT(to);

void main() {
    EACH(i, uint(to.length())) {
        uint value = mixed(from[i % uint(from.length())], push.seed ^ i);
        if ((value & 3u) != 0u) to[i] = value;
    }
}

// Adds every word of `from` to some word of `sums`; the order does not matter.
#version 460
#include "words.glsl"

IN(from);
INOUT(sums);

void main() {
    EACH(i, uint(from.length())) { atomicAdd(sums[mixed(i, push.seed) % uint(sums.length())], from[i]); }
}

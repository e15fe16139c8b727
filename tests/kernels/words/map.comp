// Writes every word of `to`, from the words of `from`.
#version 460
#include "words.glsl"

IN(from);
OUT(to);

void main() {
    EACH(i, uint(to.length())) { to[i] = mixed(from[i % uint(from.length())], push.seed + i); }
}

// Reads and writes every word of `words`.
#version 460
#include "words.glsl"

IN(from);
INOUT(words);

void main() {
    EACH(i, uint(words.length())) { words[i] = mixed(words[i], from[i % uint(from.length())] + push.seed); }
}

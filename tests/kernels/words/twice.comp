// Writes every word of `words` and reads it back: earlier contents do not matter.
#version 460
#include "words.glsl"

IN(from);
INOUT(words);

void main() {
    EACH(i, uint(words.length())) {
        words[i] = mixed(from[i % uint(from.length())], push.seed);
        words[i] = words[i] * 5u + 1u;
    }
}

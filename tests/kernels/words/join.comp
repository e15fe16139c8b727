// Writes every word of `to`, from two sources.
#version 460
#include "words.glsl"

IN(left);
IN(right);
OUT(to);

void main() {
    EACH(i, uint(to.length())) {
        to[i] = mixed(left[i % uint(left.length())] + push.seed, right[(i + push.seed) % uint(right.length())]);
    }
}

// Writes every word of `to` from a uniform, and from `from`.
#version 460
#include "words.glsl"

IN(from);
OUT(to);
layout(scalar) uniform AddendBlock { uvec4 addend; };

void main() {
    EACH(i, uint(to.length())) { to[i] = mixed(from[i % uint(from.length())], addend[i & 3u] + push.seed); }
}

// As weights_transpose.comp, for weights in units of 1/65535, stored two a word in either order. Two entries an
// invocation.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, entries);
IN(uint, order);       // entries sorted by column
IN(uint, pixels);
IN(uint, parts);       // of entries, a word each
OUT(uint, rows);
OUT(uint, weights);     // two a word, by rows
OUT(uint, row_weights); // and by columns

void main() {
    uint word = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uint count = entries[0].count;
    if (2u * word >= count) return;
    uint by_row = 0u, by_column = 0u;
    [[unroll]] for (uint k = 0u; k < 2u; k++) {
        uint s = 2u * word + k;
        if (s >= count) break;
        uint e = order[s];
        rows[s] = pixels[e];
        by_row |= parts[s] << (16u * k);
        by_column |= parts[e] << (16u * k);
    }
    weights[word] = by_row;
    row_weights[word] = by_column;
}

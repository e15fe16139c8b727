// Entries of the sparse matrix in the order of their columns: pixel and weight of each.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, entries);
IN(uint, order); // entries sorted by column
IN(uint, pixels);
IN(float, weights);
OUT(uint, rows);
OUT(float, row_weights);

void main() {
    uint s = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (s >= entries[0].count) return;
    uint e = order[s];
    rows[s] = pixels[e];
    row_weights[s] = weights[e];
}

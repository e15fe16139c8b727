// First entry of each column of the sparse matrix, from its entries sorted by column; the last word is their number.
#version 460
#include "common.glsl"
#include "work.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, entries);
IN(uint, sorted_columns);
OUT(uint, column_starts); // [columns + 1]

void main() {
    uint column = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (column >= column_starts.length()) return;
    // The first entry that is not before this column.
    uint low = 0u, high = entries[0].count;
    while (low < high) {
        uint middle = low + (high - low) / 2u;
        if (sorted_columns[middle] < column) low = middle + 1u;
        else high = middle;
    }
    column_starts[column] = low;
}

// A block of a matrix product: 64 rows by 33 columns, 96 invocations with 4 x 6 results each, the shared dimension in
// steps of 32. The including kernel fills `left` and `right` between barriers.

const uint TILE_ROWS = 64u;
const uint TILE_DEPTH = 32u;
const uint TILE_COLUMNS = 36u;           // 33, and three of nothing
const uint LEFT_PITCH = TILE_ROWS + 4u;  // stores of four neighboring words of eight samples hit different banks

shared float left[TILE_DEPTH * LEFT_PITCH];    // by depth, then row
shared float right[TILE_DEPTH * TILE_COLUMNS]; // by depth, then column

void multiply_tile(uint row, uint column, inout vec4 sums[6]) {
    for (uint k = 0u; k < TILE_DEPTH; k++) {
        uint l = k * LEFT_PITCH + row, r = k * TILE_COLUMNS + column;
        vec4 a = vec4(left[l], left[l + 1u], left[l + 2u], left[l + 3u]);
        [[unroll]] for (uint c = 0u; c < 6u; c++) sums[c] += a * right[r + c];
    }
}

// Parameters of Gaussians and their moments, in columns of four numbers.
//
// The Gaussians lie in blocks of 32, and their columns in pieces of four: a Gaussian's numbers of a piece are 64 bytes side by
// side, and those of the block's other Gaussians follow. So the lanes of a subgroup read memory that lies together, and a
// Gaussian whose neighbors are culled wastes no part of a line. Columns (passes/src/scene/columns.rs has the same):
//   0 mean and opacity logit, 1 log scale and an unused number, 2 rotation,
//   3 and on: spherical harmonics, three channels of each coefficient in turn,
//   the last one, if Gaussians have normals: normal and an unused number.
// In compact storage (passes/src/scene/compact.rs) a column of 16 bytes holds two columns of harmonics, or both moments of
// a column.

layout(constant_id = 18) const bool COMPACT = false;
layout(constant_id = 19) const uint MOMENT_COLUMNS = 15; // of moments and of gradients
layout(constant_id = 23) const uint COLUMNS = 15;        // of parameters: as many, fewer in compact storage

const uint BLOCK = 32u;
const uint PIECE_COLUMNS = 4u;
const uint HARMONICS = 3u; // first column of the harmonics

// Where one of `columns` columns of a Gaussian is. The last piece may be narrower.
uint column_among(uint i, uint column, uint columns) {
    uint piece = column / PIECE_COLUMNS, width = min(PIECE_COLUMNS, columns - piece * PIECE_COLUMNS);
    return BLOCK * (i / BLOCK * columns + piece * PIECE_COLUMNS) + i % BLOCK * width + column % PIECE_COLUMNS;
}

// Where a column of a Gaussian's parameters is.
uint column_of(uint i, uint column) { return column_among(i, column, COLUMNS); }

// Where the moments of a column are.
uint moments_of(uint i, uint column) { return column_among(i, column, MOMENT_COLUMNS); }

// Columns of the harmonics up to a degree, and their numbers.
uint harmonic_numbers(uint degree) { return 3u * (degree + 1u) * (degree + 1u); }
uint harmonic_columns(uint degree) { return (harmonic_numbers(degree) + 3u) / 4u; }

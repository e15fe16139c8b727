// Parameters of Gaussians and their moments, in columns of four numbers.
//
// The Gaussians lie in blocks of 32. Within a block, the values of one column lie side by side, so that the lanes of a subgroup
// read and write whole lines of memory. Columns (passes/src/scene/columns.rs has the same):
//   0 mean and opacity logit, 1 log scale and an unused number, 2 rotation,
//   3 and on: spherical harmonics, three channels of each coefficient in turn,
//   the last one, if Gaussians have normals: normal and an unused number.

layout(constant_id = 23) const uint COLUMNS = 15;

const uint BLOCK = 32u;
const uint HARMONICS = 3u; // first column of the harmonics

// Where column 0 of a Gaussian is; BLOCK further on lies the next column.
uint first_column(uint i) { return i / BLOCK * (COLUMNS * BLOCK) + i % BLOCK; }

// Columns of the harmonics up to a degree, and their numbers.
uint harmonic_numbers(uint degree) { return 3u * (degree + 1u) * (degree + 1u); }
uint harmonic_columns(uint degree) { return (harmonic_numbers(degree) + 3u) / 4u; }

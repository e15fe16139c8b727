// Products of a square matrix with columns of numbers by a workgroup of one subgroup: 16-bit operands, 32-bit sums.
//
// Both operands and the sums lie in shared memory, row by row; the matrix is WIDTH x WIDTH, the others WIDTH x BREADTH.
// They are cut into tiles of ROWS x DEPTH, DEPTH x COLUMNS and ROWS x COLUMNS. All tiles of the sums come from
//     matrix_product()
// once every invocation has written its share of matrix_layer and matrix_columns, of numbers from half_of(); it contains a
// barrier before and after. Needs WIDTH, WORKGROUP, ROWS, COLUMNS, DEPTH; call from uniform control flow.
//
// MATRIX_UNITS 1: by the device's units (VK_KHR_cooperative_matrix). A kernel requires the extension itself, since only
// this mode needs it. 0: the same tiles by ordinary instructions, an element of a tile after the other by lane; works on
// every Vulkan device, for tests: all but the three operations on tiles is the same.

// Never narrower than a tile; columns beyond the workgroup stay zero.
const uint BREADTH = WORKGROUP > COLUMNS ? WORKGROUP : COLUMNS;

// Numbers that 16 bits hold.
const float LARGEST_HALF = 65504.0;

#if MATRIX_UNITS
#define HALF float16_t
HALF half_of(float x) { return float16_t(clamp(x, -LARGEST_HALF, LARGEST_HALF)); }
#else
#include "half.glsl"
#define HALF float
// Rounded in code: NVIDIA's compiler removes a packing that is unpacked at once, and the rounding with it.
HALF half_of(float x) { return unpackHalf2x16(half_bits(x)).x; }
#endif

shared HALF matrix_layer[WIDTH * WIDTH];
shared HALF matrix_columns[WIDTH * BREADTH];
shared float matrix_sums[WIDTH * BREADTH];

#if MATRIX_UNITS

#define PIECE_OF(T, rows, columns, use) coopmat<T, gl_ScopeSubgroup, rows, columns, use>

// Where the pieces begin: of the sums, and of the operands' rows and columns that they come from.
void matrix_piece(uint row, uint column) {
    PIECE_OF(float, ROWS, COLUMNS, gl_MatrixUseAccumulator)
    sum = PIECE_OF(float, ROWS, COLUMNS, gl_MatrixUseAccumulator)(0.0);
    for (uint k = 0u; k < WIDTH; k += DEPTH) {
        PIECE_OF(float16_t, ROWS, DEPTH, gl_MatrixUseA) left;
        PIECE_OF(float16_t, DEPTH, COLUMNS, gl_MatrixUseB) right;
        coopMatLoad(left, matrix_layer, row * WIDTH + k, WIDTH, gl_CooperativeMatrixLayoutRowMajor);
        coopMatLoad(right, matrix_columns, k * BREADTH + column, BREADTH, gl_CooperativeMatrixLayoutRowMajor);
        sum = coopMatMulAdd(left, right, sum);
    }
    coopMatStore(sum, matrix_sums, row * BREADTH + column, BREADTH, gl_CooperativeMatrixLayoutRowMajor);
}

#else

void matrix_piece(uint row, uint column) {
    for (uint e = gl_LocalInvocationID.x; e < ROWS * COLUMNS; e += WORKGROUP) {
        uint r = row + e / COLUMNS, c = column + e % COLUMNS;
        float sum = 0.0;
        for (uint k = 0u; k < WIDTH; k += DEPTH) {
            for (uint i = k; i < k + DEPTH; i++) {
                sum = fma(matrix_layer[r * WIDTH + i], matrix_columns[i * BREADTH + c], sum);
            }
        }
        matrix_sums[r * BREADTH + c] = sum;
    }
}

#endif

// Clears the columns that no invocation writes.
void matrix_begin() {
    for (uint i = gl_LocalInvocationID.x; i < WIDTH * BREADTH; i += WORKGROUP) matrix_columns[i] = HALF(0.0);
}

void matrix_product() {
    barrier();
    for (uint row = 0u; row < WIDTH; row += ROWS) {
        for (uint column = 0u; column < BREADTH; column += COLUMNS) matrix_piece(row, column);
    }
    barrier();
}

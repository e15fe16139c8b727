// Products of matrices by a workgroup of one subgroup: 16-bit operands, 32-bit sums.
//
// Operands and sums lie in shared memory, row by row. Square layers are WIDTH x WIDTH and take MATRIX_LAYERS places from
// layer_at(0) on. Other operands have a column for each invocation and take MATRIX_ROWS rows from rows_at(0) on. Products
// are cut into tiles of ROWS x DEPTH, DEPTH x COLUMNS and ROWS x COLUMNS.
//     matrix_product(layer, columns)  matrix_sums = layer * columns
//     MATRIX_ADD(sums, wide, left, right, factor)  sums += factor * left * right^T; left: WIDTH rows, right: `wide` rows
//     MATRIX_STORE(sums, wide)  matrix_sums = sums
// MATRIX_SUMS(sums, wide) declares WIDTH x wide sums that stay in registers, as zero; `wide` is a multiple of COLUMNS. All
// need uniform control flow, and a barrier between writes of shared memory and their reads. Rows are padded, since
// otherwise eight rows of a tile would share the banks of shared memory.
//
// MATRIX_UNITS 1: by the device's units (VK_KHR_cooperative_matrix). A kernel requires the extension itself, since only
// this mode needs it. 0: the same tiles by ordinary instructions, an element of a tile after the other by lane; works on
// every Vulkan device, for tests: all but the operations on tiles is the same.
//
// Needs WIDTH, WORKGROUP, MATRIX_LAYERS, MATRIX_ROWS.

layout(constant_id = 35) const uint ROWS = 16;    // of a tile of the left operand and of the sums
layout(constant_id = 36) const uint COLUMNS = 16; // of a tile of the right operand and of the sums
layout(constant_id = 37) const uint DEPTH = 16;   // columns of a tile of the left operand

// Never narrower than a tile; columns beyond the workgroup stay zero.
const uint TILE_BREADTH = COLUMNS > DEPTH ? COLUMNS : DEPTH;
const uint BREADTH = WORKGROUP > TILE_BREADTH ? WORKGROUP : TILE_BREADTH;

// Numbers of a row, with padding. Rows start at multiples of 16 bytes, which units require.
const uint LAYER_PITCH = WIDTH + 8u;
const uint PITCH = BREADTH + 8u;
const uint SUM_PITCH = (BREADTH > WIDTH ? BREADTH : WIDTH) + 4u;

uint layer_at(uint i) { return i * WIDTH * LAYER_PITCH; }
uint rows_at(uint row) { return MATRIX_LAYERS * WIDTH * LAYER_PITCH + row * PITCH; }
const uint OPERANDS = MATRIX_LAYERS * WIDTH * LAYER_PITCH + MATRIX_ROWS * PITCH;

shared float matrix_sums[WIDTH * SUM_PITCH];

// Numbers that 16 bits hold.
const float LARGEST_HALF = 65504.0;

#if MATRIX_UNITS

shared float16_t matrix_operands[OPERANDS];

float16_t half_of(float x) { return float16_t(clamp(x, -LARGEST_HALF, LARGEST_HALF)); }

// Rows 2 pair and 2 pair + 1 of a column of the operand at `at`.
void matrix_put(uint at, uint pitch, uint pair, uint column, vec2 x) {
    matrix_operands[at + 2u * pair * pitch + column] = half_of(x.x);
    matrix_operands[at + (2u * pair + 1u) * pitch + column] = half_of(x.y);
}

vec2 matrix_get(uint at, uint pitch, uint pair, uint column) {
    return vec2(matrix_operands[at + 2u * pair * pitch + column], matrix_operands[at + (2u * pair + 1u) * pitch + column]);
}

#define PIECE_OF(T, rows, columns, use) coopmat<T, gl_ScopeSubgroup, rows, columns, use>
#define SUM_PIECE PIECE_OF(float, ROWS, COLUMNS, gl_MatrixUseAccumulator)
#define LEFT_PIECE PIECE_OF(float16_t, ROWS, DEPTH, gl_MatrixUseA)
#define RIGHT_PIECE PIECE_OF(float16_t, DEPTH, COLUMNS, gl_MatrixUseB)

void matrix_product(uint layer, uint columns) {
    [[unroll]] for (uint row = 0u; row < WIDTH; row += ROWS) {
        LEFT_PIECE left[WIDTH / DEPTH];
        [[unroll]] for (uint k = 0u; k < WIDTH / DEPTH; k++) {
            coopMatLoad(left[k], matrix_operands, layer + row * LAYER_PITCH + k * DEPTH, LAYER_PITCH,
                        gl_CooperativeMatrixLayoutRowMajor);
        }
        [[unroll]] for (uint column = 0u; column < BREADTH; column += COLUMNS) {
            SUM_PIECE sum = SUM_PIECE(0.0);
            [[unroll]] for (uint k = 0u; k < WIDTH / DEPTH; k++) {
                RIGHT_PIECE right;
                coopMatLoad(right, matrix_operands, columns + k * DEPTH * PITCH + column, PITCH,
                            gl_CooperativeMatrixLayoutRowMajor);
                sum = coopMatMulAdd(left[k], right, sum);
            }
            coopMatStore(sum, matrix_sums, row * SUM_PITCH + column, SUM_PITCH, gl_CooperativeMatrixLayoutRowMajor);
        }
    }
}

#ifdef MATRIX_BACKWARD
// Macros, so that sums are variables of main(): drivers rarely see matrices elsewhere.
#define MATRIX_SUMS(sums_, wide_)                                                                              \
    SUM_PIECE sums_[WIDTH / ROWS * ((wide_) / COLUMNS)];                                                       \
    [[unroll]] for (uint i_ = 0u; i_ < WIDTH / ROWS * ((wide_) / COLUMNS); i_++) sums_[i_] = SUM_PIECE(0.0);

#define MATRIX_ADD(sums_, wide_, left_at_, right_at_, factor_)                                                 \
    [[unroll]] for (uint r_ = 0u; r_ < WIDTH / ROWS; r_++) {                                                   \
        LEFT_PIECE left_[BREADTH / DEPTH];                                                                     \
        [[unroll]] for (uint k_ = 0u; k_ < BREADTH / DEPTH; k_++) {                                            \
            coopMatLoad(left_[k_], matrix_operands, left_at_ + r_ * ROWS * PITCH + k_ * DEPTH, PITCH,          \
                        gl_CooperativeMatrixLayoutRowMajor);                                                   \
        }                                                                                                      \
        [[unroll]] for (uint c_ = 0u; c_ < (wide_) / COLUMNS; c_++) {                                          \
            SUM_PIECE sum_ = SUM_PIECE(0.0);                                                                   \
            [[unroll]] for (uint k_ = 0u; k_ < BREADTH / DEPTH; k_++) {                                        \
                RIGHT_PIECE right_;                                                                            \
                coopMatLoad(right_, matrix_operands, right_at_ + c_ * COLUMNS * PITCH + k_ * DEPTH, PITCH,     \
                            gl_CooperativeMatrixLayoutColumnMajor);                                            \
                sum_ = coopMatMulAdd(left_[k_], right_, sum_);                                                 \
            }                                                                                                  \
            sums_[r_ * ((wide_) / COLUMNS) + c_] = sums_[r_ * ((wide_) / COLUMNS) + c_] + sum_ * (factor_);    \
        }                                                                                                      \
    }

#define MATRIX_STORE(sums_, wide_)                                                                             \
    [[unroll]] for (uint r_ = 0u; r_ < WIDTH / ROWS; r_++) {                                                   \
        [[unroll]] for (uint c_ = 0u; c_ < (wide_) / COLUMNS; c_++) {                                          \
            coopMatStore(sums_[r_ * ((wide_) / COLUMNS) + c_], matrix_sums, r_ * ROWS * SUM_PITCH + c_ * COLUMNS, \
                         SUM_PITCH, gl_CooperativeMatrixLayoutRowMajor);                                       \
        }                                                                                                      \
    }
#endif

#else

#include "half.glsl"

// A word holds two rows of a column.
shared uint matrix_operands[OPERANDS / 2u];

// Rounded in code: NVIDIA's compiler removes a packing that is unpacked at once, and the rounding with it.
void matrix_put(uint at, uint pitch, uint pair, uint column, vec2 x) {
    matrix_operands[at / 2u + pair * pitch + column] = pack_halves(x);
}

vec2 matrix_get(uint at, uint pitch, uint pair, uint column) {
    return unpack_halves(matrix_operands[at / 2u + pair * pitch + column]);
}

float matrix_element(uint at, uint pitch, uint row, uint column) {
    return matrix_get(at, pitch, row / 2u, column)[row % 2u];
}

// Calls a macro for each element of a tile that is this lane's: its place in the lane, row and column in the tile.
const uint SHARE = (ROWS * COLUMNS + WORKGROUP - 1u) / WORKGROUP;
#define EACH_ELEMENT(i, r, c)                                                                                  \
    for (uint i = 0u, e_ = gl_LocalInvocationID.x, r = e_ / COLUMNS, c = e_ % COLUMNS; e_ < ROWS * COLUMNS;    \
         i++, e_ += WORKGROUP, r = e_ / COLUMNS, c = e_ % COLUMNS)

void matrix_product(uint layer, uint columns) {
    for (uint row = 0u; row < WIDTH; row += ROWS) {
        for (uint column = 0u; column < BREADTH; column += COLUMNS) {
            EACH_ELEMENT(i, r, c) {
                float sum = 0.0;
                [[unroll]] for (uint k = 0u; k < WIDTH; k++) {
                    sum = fma(matrix_element(layer, LAYER_PITCH, row + r, k),
                              matrix_element(columns, PITCH, k, column + c), sum);
                }
                matrix_sums[(row + r) * SUM_PITCH + column + c] = sum;
            }
        }
    }
}

#ifdef MATRIX_BACKWARD
#define MATRIX_SUMS(sums_, wide_)                                                                              \
    float sums_[WIDTH / ROWS * ((wide_) / COLUMNS) * SHARE];                                                   \
    for (uint i_ = 0u; i_ < WIDTH / ROWS * ((wide_) / COLUMNS) * SHARE; i_++) sums_[i_] = 0.0;

float matrix_dot(uint left, uint row, uint right, uint column) {
    float sum = 0.0;
    [[unroll]] for (uint k = 0u; k < BREADTH; k++) {
        sum = fma(matrix_element(left, PITCH, row, k), matrix_element(right, PITCH, column, k), sum);
    }
    return sum;
}

#define MATRIX_ADD(sums_, wide_, left_at_, right_at_, factor_)                                                 \
    for (uint t_ = 0u; t_ < WIDTH / ROWS * ((wide_) / COLUMNS); t_++) {                                        \
        uint row_ = t_ / ((wide_) / COLUMNS) * ROWS, column_ = t_ % ((wide_) / COLUMNS) * COLUMNS;             \
        EACH_ELEMENT(i, r, c) {                                                                                \
            sums_[t_ * SHARE + i] += matrix_dot(left_at_, row_ + r, right_at_, column_ + c) * (factor_);       \
        }                                                                                                      \
    }

#define MATRIX_STORE(sums_, wide_)                                                                             \
    for (uint t_ = 0u; t_ < WIDTH / ROWS * ((wide_) / COLUMNS); t_++) {                                        \
        uint row_ = t_ / ((wide_) / COLUMNS) * ROWS, column_ = t_ % ((wide_) / COLUMNS) * COLUMNS;             \
        EACH_ELEMENT(i, r, c) matrix_sums[(row_ + r) * SUM_PITCH + column_ + c] = sums_[t_ * SHARE + i];       \
    }
#endif

#endif

// Clears the operands: columns that no invocation writes, and rows that pad a tile.
void matrix_begin() {
    for (uint i = gl_LocalInvocationID.x; i < MATRIX_ROWS / 2u * BREADTH; i += WORKGROUP) {
        matrix_put(rows_at(0u), PITCH, i / BREADTH, i % BREADTH, vec2(0.0));
    }
}

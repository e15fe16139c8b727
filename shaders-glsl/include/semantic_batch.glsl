// A batch of samples or pixels, TILES a lane: their features, decoded lengths and classes.
//
// Rows of `matrices` (A^T A, then T A) are fetched once for the whole batch. Needs SUBGROUP, TILES, CLASSES and the buffer
// `matrices`.
#include "lane_items.glsl"

const uint ROWS = AUGMENTED + CLASSES;
const uint BATCH = SUBGROUP * TILES;

// Below this share of its parts' size, those of every feature and the bias, a decoded vector is rounding noise: it has length
// and direction of nothing.
const float NOTHING = 1e-6; // squared

// Arrays that are indexed by a variable. Where private ones spill on GPUs, they lie in shared memory on wide subgroups, and
// each lane uses words of its own. On processors private ones are faster.
#ifdef STAGES_IN_SHARED
const bool STAGES = SUBGROUP >= 16u;
#else
const bool STAGES = false;
#endif
shared float shared_staged[STAGES ? TILES * SPREAD * SUBGROUP : 1u];

// Writes and reads an element of such an array, whose private form is `array_`.
#define STAGED_AT(i_) shared_staged[(i_) * SUBGROUP + gl_SubgroupInvocationID]
#define STAGE(array_, i_, value_)                                                                              \
    {                                                                                                          \
        if (STAGES) STAGED_AT(i_) = value_;                                                                    \
        else array_[i_] = value_;                                                                              \
    }
#define STAGED(array_, i_) (STAGES ? STAGED_AT(i_) : array_[i_])

float staged[TILES * SPREAD];  // as `f`
float f[TILES * SPREAD];       // features brought to at most one; zero where not live
float u[TILES * SPREAD];       // A^T A f', but for its last number; descend() overwrites it with k f'
float bias[TILES];             // factor of the bias: 1 over the divisor of the features; likewise
bool live[TILES];              // counts
float inverse[TILES];          // 1 / length of the decoded vector; 0 where it has none

#define EACH_TILE(t) [[unroll]] for (uint t = 0u; t < TILES; t++)

float row[HELD]; // of `matrices`, and its last number
float last;

// On narrow subgroups every workgroup keeps all rows: on processors that is faster than fetching them again and again.
const bool KEEP = SUBGROUP <= 8u;
float rows[ROWS * (HELD + 1u)];

void keep_rows() {
    if (KEEP) {
        for (uint i = 0u; i < ROWS; i++) {
            SHORT for (uint h = 0u; h <= HELD; h++) {
                rows[i * (HELD + 1u) + h] = matrices[i * PITCH + min(h * ACROSS + column(), FEATURES)];
            }
        }
    }
}

void fetch_row(uint i) {
    if (KEEP) {
        EACH_HELD(h) row[h] = rows[i * (HELD + 1u) + h];
        last = rows[i * (HELD + 1u) + HELD];
    } else {
        EACH_HELD(h) row[h] = matrices[i * PITCH + h * ACROSS + column()];
        last = matrices[i * PITCH + FEATURES];
    }
}

// Sum over features of x y for each item.
#define DOT_ITEMS(result, x, y, t)                                                                             \
    float result;                                                                                              \
    {                                                                                                          \
        float values_[ACROSS];                                                                                 \
        EACH_ITEM(n_) {                                                                                        \
            values_[n_] = 0.0;                                                                                 \
            EACH_HELD(h_) values_[n_] = fma(x, y, values_[n_]);                                                \
        }                                                                                                      \
        JOIN_LANES(float, values_, JOIN_SUM)                                                                   \
        result = values_[0];                                                                                   \
    }
#define AT_(t) ((t) * SPREAD + n_ * HELD + h_)

// Dot product of the row with f', for this lane's item.
float product(uint t) {
    DOT_ITEMS(sum, row[h_], f[AT_(t)], t)
    return fma(last, bias[t], sum);
}

// Takes features from `staged`. Items with non-finite features are dropped. The loss on features depends on their
// direction alone, and huge ones would overflow: hence the division.
void bring() {
    EACH_TILE(t) {
        float x[SPREAD];
        [[unroll]] for (uint k = 0u; k < SPREAD; k++) x[k] = STAGED(staged, t * SPREAD + k);
        // Compared as integers: the bits of non-finite numbers are larger than those of finite ones.
        uint top[ACROSS];
        EACH_ITEM(n) {
            top[n] = 0u;
            EACH_HELD(h) top[n] = max(top[n], floatBitsToUint(x[n * HELD + h]) & 0x7fffffffu);
        }
        JOIN_LANES(uint, top, JOIN_MAX)
        live[t] = live[t] && top[0] < 0x7f800000u;
        float largest = live[t] ? max(1.0, uintBitsToFloat(top[0])) : 0.0;
        bias[t] = live[t] ? 1.0 / largest : 0.0;
        EACH_ITEM(n) {
            float by = subgroupShuffle(largest, lane_of(n));
            EACH_HELD(h) f[t * SPREAD + n * HELD + h] = by > 0.0 ? x[n * HELD + h] / by : 0.0;
        }
    }
}

// Lengths, and `u`.
void measure() {
    EACH_TILE(t) [[unroll]] for (uint k = 0u; k < SPREAD; k++) u[t * SPREAD + k] = 0.0;
    float diagonal[HELD]; // squared lengths of the decoder's columns
    EACH_HELD(h) diagonal[h] = 0.0;
    for (uint j = 0u; j < ACROSS; j++) {
        EACH_HELD(g) {
            fetch_row(g * ACROSS + j);
            diagonal[g] = column() == j ? row[g] : diagonal[g];
            EACH_TILE(t) EACH_ITEM(n) {
                uint at = t * SPREAD + n * HELD;
                float s = subgroupShuffle(f[at + g], lane_of(j));
                EACH_HELD(h) u[at + h] = fma(s, row[h], u[at + h]);
            }
        }
    }
    fetch_row(FEATURES);
    EACH_TILE(t) {
        DOT_ITEMS(both, row[h_], f[AT_(t)], t) // of weights and bias
        EACH_ITEM(n) {
            float s = subgroupShuffle(bias[t], lane_of(n));
            EACH_HELD(h) u[t * SPREAD + n * HELD + h] = fma(s, row[h], u[t * SPREAD + n * HELD + h]);
        }
        DOT_ITEMS(square, f[AT_(t)], u[AT_(t)], t)
        DOT_ITEMS(parts, diagonal[h_] * f[AT_(t)], f[AT_(t)], t)
        float bias_part = last * bias[t] * bias[t];
        square = fma(bias[t], both, square + bias_part);
        float least = max(1e-16 * bias[t] * bias[t], NOTHING * (parts + bias_part));
        inverse[t] = square > least ? 1.0 / sqrt(square) : 0.0;
    }
}

// What the softmax over all classes needs: largest logit, sum of exponentials below it.
struct Softmax {
    float top;
    float total;
};

void add_logit(inout Softmax s, float logit) {
    float e = exp(-abs(logit - s.top));
    s.total = logit > s.top ? fma(s.total, e, 1.0) : s.total + e;
    s.top = max(s.top, logit);
}

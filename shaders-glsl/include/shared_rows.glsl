// Rows of 33 numbers that every lane needs whole: lanes fetch them together and broadcast them, which costs a fraction of
// fetching them in each lane. Needs SUBGROUP.

const uint FETCHES = (AUGMENTED + SUBGROUP - 1u) / SUBGROUP; // numbers of a row that a lane has

#define FETCH_ROW(row, buffer_, at)                                                                            \
    float row[FETCHES];                                                                                        \
    [[unroll]] for (uint q_ = 0u; q_ < FETCHES; q_++)                                                          \
        row[q_] = buffer_[(at) + min(q_ * SUBGROUP + gl_SubgroupInvocationID, AUGMENTED - 1u)];

// Sums of 33 columns each, `held` of them a lane. Loops here have 32 rounds at most and the last column is for itself:
// drivers of processors unroll no longer ones, and what is indexed by a counter lies in memory.
#define CLEAR_SUMS(sums, held)                                                                                 \
    [[unroll]] for (uint h_ = 0u; h_ < held; h_++) {                                                           \
        [[unroll]] for (uint c_ = 0u; c_ < FEATURES; c_++) sums[c_ * held + h_] = 0.0;                         \
        sums[FEATURES * held + h_] = 0.0;                                                                      \
    }

// Adds rows times factors.
#define ADD_ROW(sums, row, factors, held)                                                                      \
    [[unroll]] for (uint c_ = 0u; c_ < FEATURES; c_++) ADD_COLUMN(sums, row, factors, held)                    \
    {                                                                                                          \
        const uint c_ = FEATURES;                                                                              \
        ADD_COLUMN(sums, row, factors, held)                                                                   \
    }
#define ADD_COLUMN(sums, row, factors, held)                                                                   \
    {                                                                                                          \
        float x_ = subgroupShuffle(row[c_ / SUBGROUP], c_ % SUBGROUP);                                         \
        [[unroll]] for (uint h_ = 0u; h_ < held; h_++)                                                         \
            sums[c_ * held + h_] = fma(x_, factors[h_], sums[c_ * held + h_]);                                 \
    }

// Stores one row of such sums, the `which`-th of a lane, as row `at` of a buffer of vec4s.
#define STORE_ROW(buffer_, at, sums, held, which)                                                              \
    [[unroll]] for (uint v_ = 0u; v_ < PITCH / 4u; v_++) {                                                     \
        vec4 four_ = vec4(0.0);                                                                                \
        [[unroll]] for (uint k_ = 0u; k_ < 4u; k_++)                                                           \
            if (4u * v_ + k_ < AUGMENTED) four_[k_] = sums[min(4u * v_ + k_, FEATURES) * held + which];        \
        buffer_[(at) * (PITCH / 4u) + v_] = four_;                                                             \
    }

// Sums of many values at once over the lanes of a subgroup, in a fixed order: afterwards lane j holds the sum of value j.
//
// At each distance half of the values change hands, so S values cost S - 1 shuffles, not S log2 S. Needs a constant
// SUBGROUP, a power of two up to 128. `values` has SUBGROUP elements and is overwritten.
//
// The distances are written out one by one: not every compiler unrolls a loop that halves its counter, and an array that
// is indexed in a loop lies in memory.

#define LANE_HALVE(values, reach)                                                                              \
    if (SUBGROUP > reach) {                                                                                    \
        bool upper_ = (gl_SubgroupInvocationID & reach) != 0u;                                                 \
        [[unroll]] for (uint j_ = 0u; j_ < reach; ++j_) {                                                      \
            float low_ = values[j_], high_ = values[(j_ + reach) % SUBGROUP];                                  \
            values[j_] = (upper_ ? high_ : low_) + subgroupShuffleXor(upper_ ? low_ : high_, reach);           \
        }                                                                                                      \
    }

#define LANE_SUMS(values)                                                                                      \
    LANE_HALVE(values, 64u)                                                                                    \
    LANE_HALVE(values, 32u)                                                                                    \
    LANE_HALVE(values, 16u)                                                                                    \
    LANE_HALVE(values, 8u)                                                                                     \
    LANE_HALVE(values, 4u)                                                                                     \
    LANE_HALVE(values, 2u)                                                                                     \
    LANE_HALVE(values, 1u)

// The same sums of the first `count` values alone, with the same bits. Neighbors are paired, so that padding takes no
// shuffles: 9 values on 32 lanes take 5 + 3 + 2 + 1 + 1 = 12 instead of 31. `count` is at least 1, and a constant once
// loops are unrolled. Lanes hold the sums in another order: each that of value `lane_of_sum()`.
#define LANE_HALVE_PAIRS(values, count, reach)                                                                 \
    if (SUBGROUP > reach) {                                                                                    \
        bool upper_ = (gl_SubgroupInvocationID & reach) != 0u;                                                 \
        [[unroll]] for (uint j_ = 0u; j_ < reach; ++j_) {                                                      \
            if (j_ * (SUBGROUP / reach) < count) {                                                             \
                bool pair_ = (2u * j_ + 1u) * (SUBGROUP / (2u * reach)) < count;                               \
                float low_ = values[2u * j_], high_ = pair_ ? values[(2u * j_ + 1u) % SUBGROUP] : 0.0;         \
                values[j_] = (upper_ ? high_ : low_) + subgroupShuffleXor(upper_ ? low_ : high_, reach);       \
            }                                                                                                  \
        }                                                                                                      \
    }

#define LANE_SUMS_OF(values, count)                                                                            \
    LANE_HALVE_PAIRS(values, count, 64u)                                                                       \
    LANE_HALVE_PAIRS(values, count, 32u)                                                                       \
    LANE_HALVE_PAIRS(values, count, 16u)                                                                       \
    LANE_HALVE_PAIRS(values, count, 8u)                                                                        \
    LANE_HALVE_PAIRS(values, count, 4u)                                                                        \
    LANE_HALVE_PAIRS(values, count, 2u)                                                                        \
    LANE_HALVE_PAIRS(values, count, 1u)

uint lane_of_sum() {
    return bitfieldReverse(gl_SubgroupInvocationID) >> (32u - uint(findMSB(SUBGROUP)));
}

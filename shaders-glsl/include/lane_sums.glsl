// Sums over the lanes of a subgroup of many values at once, in a fixed order: afterwards lane j holds the sum of value j.
//
// Halving: at each distance half of the values change hands, so S values cost S - 1 shuffles, not S log2 S. Needs a
// constant SUBGROUP, a power of two. `values` has SUBGROUP elements and is used up.

#define LANE_SUMS(values)                                                                                      \
    [[unroll]] for (uint reach_ = SUBGROUP / 2u; reach_ > 0u; reach_ /= 2u) {                                  \
        bool upper_ = (gl_SubgroupInvocationID & reach_) != 0u;                                                \
        [[unroll]] for (uint j_ = 0u; j_ < reach_; ++j_) {                                                     \
            float given_ = upper_ ? values[j_] : values[j_ + reach_];                                          \
            float kept_ = upper_ ? values[j_ + reach_] : values[j_];                                           \
            values[j_] = kept_ + subgroupShuffleXor(given_, reach_);                                           \
        }                                                                                                      \
    }

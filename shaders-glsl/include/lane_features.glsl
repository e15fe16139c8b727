// Features of one Gaussian, fetched once by the lanes together and broadcast to all of them.
//
// Needs constants SUBGROUP and FEATURES, and the buffer `raw_features` [Gaussians * FEATURES].

const uint FEATURE_PARTS = (FEATURES + SUBGROUP - 1u) / SUBGROUP;

#define LANE_FEATURES(into, gaussian)                                                                          \
    float into[FEATURES];                                                                                      \
    {                                                                                                          \
        float part_[FEATURE_PARTS];                                                                            \
        uint row_ = (gaussian) * FEATURES;                                                                     \
        [[unroll]] for (uint q_ = 0u; q_ < FEATURE_PARTS; ++q_)                                                \
            part_[q_] = raw_features[row_ + min(q_ * SUBGROUP + gl_SubgroupInvocationID, FEATURES - 1u)];      \
        [[unroll]] for (uint c_ = 0u; c_ < FEATURES; ++c_)                                                     \
            into[c_] = subgroupShuffle(part_[c_ / SUBGROUP], c_ % SUBGROUP);                                   \
    }

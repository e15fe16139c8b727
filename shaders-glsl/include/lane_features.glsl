// Features of one Gaussian, fetched once by the lanes together and broadcast to all of them.
//
// Needs constants SUBGROUP and FEATURES, and the buffer `raw_features` [Gaussians * FEATURES]; with FEATURE_BITS 16
// `packed_features`, two a word. One buffer is bound to both.

#include "half.glsl"

layout(constant_id = 30) const uint FEATURE_BITS = 32;

const uint FEATURE_PARTS = (FEATURES + SUBGROUP - 1u) / SUBGROUP;
const uint FEATURE_WORDS = FEATURES / 2u;
const uint PACKED_PARTS = (FEATURE_WORDS + SUBGROUP - 1u) / SUBGROUP;

#define LANE_FEATURES(into, gaussian)                                                                          \
    float into[FEATURES];                                                                                      \
    if (FEATURE_BITS == 16u) {                                                                                 \
        vec2 part_[PACKED_PARTS];                                                                              \
        uint row_ = (gaussian) * FEATURE_WORDS;                                                                \
        [[unroll]] for (uint q_ = 0u; q_ < PACKED_PARTS; ++q_)                                                 \
            part_[q_] = unpack_halves(                                                                         \
                packed_features[row_ + min(q_ * SUBGROUP + gl_SubgroupInvocationID, FEATURE_WORDS - 1u)]);     \
        [[unroll]] for (uint w_ = 0u; w_ < FEATURE_WORDS; ++w_) {                                              \
            into[2u * w_] = subgroupShuffle(part_[w_ / SUBGROUP].x, w_ % SUBGROUP);                            \
            into[2u * w_ + 1u] = subgroupShuffle(part_[w_ / SUBGROUP].y, w_ % SUBGROUP);                       \
        }                                                                                                      \
    } else {                                                                                                   \
        float part_[FEATURE_PARTS];                                                                            \
        uint row_ = (gaussian) * FEATURES;                                                                     \
        [[unroll]] for (uint q_ = 0u; q_ < FEATURE_PARTS; ++q_)                                                \
            part_[q_] = raw_features[row_ + min(q_ * SUBGROUP + gl_SubgroupInvocationID, FEATURES - 1u)];      \
        [[unroll]] for (uint c_ = 0u; c_ < FEATURES; ++c_)                                                     \
            into[c_] = subgroupShuffle(part_[c_ / SUBGROUP], c_ % SUBGROUP);                                   \
    }

// As region.glsl, with features over lanes as in lane_items.glsl: the unit vector from the mean of region b to that of
// region a, and whether the pair counts. The regions are elements of buffers.

#define LANE_DIRECTION(direction, counts, a, b)                                                                \
    float direction[HELD];                                                                                     \
    bool counts;                                                                                               \
    {                                                                                                          \
        uint top_ = 0u;                                                                                        \
        EACH_HELD(h_) {                                                                                        \
            direction[h_] = a.mean[h_ * ACROSS + column()] - b.mean[h_ * ACROSS + column()];                   \
            top_ = max(top_, floatBitsToUint(direction[h_]) & 0x7fffffffu);                                    \
        }                                                                                                      \
        top_ = subgroupMax(top_);                                                                              \
        counts = top_ < 0x7f800000u && a.count >= LEAST_PIXELS && b.count >= LEAST_PIXELS;                     \
        bool apart_ = counts && top_ > 0u;                                                                     \
        float square_ = 0.0;                                                                                   \
        EACH_HELD(h_) {                                                                                        \
            direction[h_] = apart_ ? direction[h_] / uintBitsToFloat(top_) : 0.0;                              \
            square_ = fma(direction[h_], direction[h_], square_);                                              \
        }                                                                                                      \
        float size_ = sqrt(subgroupAdd(square_) / float(SIDES));                                               \
        EACH_HELD(h_) direction[h_] = apart_ ? direction[h_] / size_ : 0.0;                                    \
    }

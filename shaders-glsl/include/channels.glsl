// Channels of a visible splat, as project writes and blending fetches them: a word each, but colors in 16 bits take two
// words for three. Needs CHANNELS; COLOR_BITS is 32 where there are no colors.

#include "half.glsl"

layout(constant_id = 24) const uint COLOR_BITS = 32;

const uint CHANNEL_WORDS = CHANNELS - (COLOR_BITS == 16u ? 1u : 0u);

#define FETCH_CHANNELS(into, features, v)                                                                      \
    float into[CHANNELS];                                                                                      \
    if (COLOR_BITS == 16u) {                                                                                   \
        uint row_ = (v) * CHANNEL_WORDS;                                                                       \
        vec2 low_ = unpack_halves(features[row_]), high_ = unpack_halves(features[row_ + 1u]);                 \
        into[0] = low_.x;                                                                                      \
        into[1u % CHANNELS] = low_.y;                                                                          \
        into[2u % CHANNELS] = high_.x;                                                                         \
        [[unroll]] for (uint c_ = 3u; c_ < CHANNELS; ++c_)                                                     \
            into[c_] = uintBitsToFloat(features[row_ + c_ - 1u]);                                              \
    } else {                                                                                                   \
        [[unroll]] for (uint c_ = 0u; c_ < CHANNELS; ++c_)                                                     \
            into[c_] = uintBitsToFloat(features[(v) * CHANNELS + c_]);                                         \
    }

// The color among them, of its first words; the third counts for nothing if there are two.
vec3 color_of_words(uint first, uint second, uint third) {
    if (COLOR_BITS == 16u) return vec3(unpack_halves(first), unpack_halves(second).x);
    return vec3(uintBitsToFloat(first), uintBitsToFloat(second), uintBitsToFloat(third));
}

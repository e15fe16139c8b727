// Weights of the sparse matrix's entries: floats, or with WEIGHT_BITS 16 two a word in units of 1/65535.

layout(constant_id = 30) const uint WEIGHT_BITS = 32;

// A function that gives the weight of an entry of a buffer of words.
#define ENTRY_WEIGHTS(name, buffer_)                                                                           \
    float name(uint e) {                                                                                       \
        if (WEIGHT_BITS == 16u)                                                                                \
            return float(bitfieldExtract(buffer_[e / 2u], int(16u * (e & 1u)), 16)) * (1.0 / 65535.0);         \
        return uintBitsToFloat(buffer_[e]);                                                                    \
    }

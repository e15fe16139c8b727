// Sums of 64-bit integers in two words each, by 32-bit atomics.
//
// The carry follows from each addition alone, so the words are right when all are done, in any order. Small numbers of
// either sign mostly cost one atomic. Needs a buffer WHOLE_SUMS of words, lower ones first.

// The two words of a number of magnitude below 2^62, rounded.
uvec2 whole_words(float x) {
    float size = roundEven(abs(x)), upper = floor(size * (1.0 / 4294967296.0));
    uint high = uint(upper), low = uint(fma(-4294967296.0, upper, size));
    if (x < 0.0) {
        low = ~low + 1u;
        high = ~high + uint(low == 0u);
    }
    return uvec2(low, high);
}

// Adds the lower word, and returns the carry.
uint add_low(uint at, uint low) {
    if (low == 0u) return 0u;
    uint before = atomicAdd(WHOLE_SUMS[2u * at], low);
    return uint(before + low < before);
}

void add_high(uint at, uint high) {
    if (high != 0u) atomicAdd(WHOLE_SUMS[2u * at + 1u], high);
}

// Adds a number of magnitude below 2^62, rounded.
void add_whole(uint at, float x) {
    uvec2 words = whole_words(x);
    add_high(at, words.y + add_low(at, words.x));
}

// What the two words say.
float whole(uint low, uint high) {
    bool negative = high >= 0x80000000u;
    if (negative) {
        low = ~low + 1u;
        high = ~high + uint(low == 0u);
    }
    float size = fma(4294967296.0, float(high), float(low));
    return negative ? -size : size;
}

// Sums of 64-bit integers in two words each, by 32-bit atomics.
//
// The carry follows from each addition alone, so the words are right when all are done, in any order. Small numbers of
// either sign mostly cost one atomic. Needs a buffer WHOLE_SUMS of words, lower ones first.

// Adds a number of magnitude below 2^62, rounded.
void add_whole(uint at, float x) {
    float size = roundEven(abs(x));
    if (size == 0.0) return;
    float upper = floor(size * (1.0 / 4294967296.0));
    uint high = uint(upper), low = uint(fma(-4294967296.0, upper, size));
    if (x < 0.0) {
        low = ~low + 1u;
        high = ~high + uint(low == 0u);
    }
    if (low != 0u) {
        uint before = atomicAdd(WHOLE_SUMS[2u * at], low);
        high += uint(before + low < before);
    }
    if (high != 0u) atomicAdd(WHOLE_SUMS[2u * at + 1u], high);
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

// Sums that do not depend on their order: 64-bit integers in two words, added with 32-bit atomics, which every device has.
//
// Needs a constant FIXED_BITS: the bits of the largest addend. `largest` are the bits of an upper bound of the addends; the
// unit of the sums is a power of two that follows from it.

int fixed_exponent(uint largest) { return clamp(FIXED_BITS + 126 - int(largest >> 23u), -126, 126); }

float power_of_two(int exponent) { return uintBitsToFloat(uint(exponent + 127) << 23u); }

// Low and high word of a number in units. Floats are cut into pieces that convert exactly.
uvec2 to_fixed(float units) {
    float y = roundEven(abs(units));
    float high = floor(y * (1.0 / 4294967296.0));
    float rest = y - high * 4294967296.0;
    float middle = floor(rest * (1.0 / 65536.0));
    uvec2 r = uvec2((uint(middle) << 16u) + uint(rest - middle * 65536.0), uint(high));
    if (units < 0.0) r = uvec2(~r.x + 1u, ~r.y + (r.x == 0u ? 1u : 0u));
    return r;
}

float from_fixed(uvec2 v, float unit) {
    bool negative = (v.y & 0x80000000u) != 0u;
    if (negative) v = uvec2(~v.x + 1u, ~v.y + (v.x == 0u ? 1u : 0u));
    float r = float(v.y) * (4294967296.0 * unit) + float(v.x) * unit;
    return negative ? -r : r;
}

// Numbers stored in 16 bits, two a word, the first in the low half; works without 16-bit storage support.
//
// Rounding is to nearest, ties to even, in code: devices may round packing differently. Values beyond the largest half
// are clamped to it; NaN stays NaN.

#ifndef HALF_GLSL
#define HALF_GLSL

uint half_bits(float x) {
    uint bits = floatBitsToUint(x), magnitude = bits & 0x7fffffffu;
    uint magnitude_bits;
    if (magnitude < 0x38800000u) {
        // Multiples of 2^-24, below the least power of two that is a normal half.
        magnitude_bits = uint(roundEven(abs(x) * 16777216.0));
    } else if (magnitude > 0x7f800000u) {
        magnitude_bits = 0x7e00u;
    } else {
        // The largest half comes first: rounding up from it would leave the range.
        magnitude = min(magnitude, 0x477fe000u);
        magnitude_bits = (magnitude - 0x38000000u + 0xfffu + (magnitude >> 13 & 1u)) >> 13;
    }
    return bits >> 16 & 0x8000u | magnitude_bits;
}

uint pack_halves(vec2 x) { return half_bits(x.x) | half_bits(x.y) << 16; }

vec2 unpack_halves(uint word) { return unpackHalf2x16(word); }

#endif

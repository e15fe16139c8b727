// Numbers that are stored in 16 bits, two a word, the first one low. No device needs to know such storage.
//
// Rounding is done here, to nearest and ties to even, because devices may pack as they like. What is larger than the largest
// half becomes that; what is no number stays none.

uint half_bits(float x) {
    uint bits = floatBitsToUint(x), magnitude = bits & 0x7fffffffu;
    uint held;
    if (magnitude < 0x38800000u) {
        held = uint(roundEven(abs(x) * 16777216.0)); // multiples of 2^-24, below the least power of two that is a normal half
    } else if (magnitude > 0x7f800000u) {
        held = 0x7e00u;
    } else {
        // The largest half comes first: rounding up from it would leave the range.
        magnitude = min(magnitude, 0x477fe000u);
        held = (magnitude - 0x38000000u + 0xfffu + (magnitude >> 13 & 1u)) >> 13;
    }
    return bits >> 16 & 0x8000u | held;
}

uint pack_halves(vec2 x) { return half_bits(x.x) | half_bits(x.y) << 16; }

vec2 unpack_halves(uint word) { return unpackHalf2x16(word); }

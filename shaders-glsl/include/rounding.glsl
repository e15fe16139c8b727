// Numbers in 16 bits, rounded at random: up with the probability of the part that is cut off, so that the mean over many
// roundings is the number itself. A number that 16 bits hold stays as it is.
//
// Steps of Adam are often smaller than a unit of the last place; rounded to nearest, they would be lost.
// The random bits are a pure function of the step's seed, the Gaussian, the column and the number.

#include "random.glsl"

const uint ROUNDING = 0x5bd1e995u; // sets these random numbers apart from others with the step's seed

uint rounding_key(uint seed, uint i) { return pcg(pcg(seed ^ ROUNDING) + i); }

// Bits of a column: 0 to 3 for the moments of each number, 4 and 5 for two parameters each.
uint rounding_bits(uint key, uint column, uint k) { return pcg(key + 8u * column + k); }

// First moments have the exponent of 32-bit floats and 8 significant bits. Moments stay below infinity.
const uint LARGEST_FLOAT = 0x7f7fffffu;

uint round_first(float x, uint random) {
    uint bits = floatBitsToUint(x);
    return (bits & 0x80000000u | min((bits & 0x7fffffffu) + (random & 0xffffu), LARGEST_FLOAT)) >> 16;
}

// Second moments have no sign, and 9 significant bits.
uint round_second(float x, uint random) {
    return min((floatBitsToUint(x) & 0x7fffffffu) + (random >> 17), LARGEST_FLOAT) >> 15;
}

float first_of(uint bits) { return uintBitsToFloat(bits << 16); }

float second_of(uint bits) { return uintBitsToFloat(bits << 15); }

// Half precision, by 13 random bits. Numbers beyond the largest half become the largest, NaN stays NaN.
uint round_half(float x, uint random) {
    uint sign = floatBitsToUint(x) >> 16 & 0x8000u, magnitude = floatBitsToUint(x) & 0x7fffffffu;
    if (magnitude > 0x7f800000u) return sign | 0x7e00u;
    magnitude = min(magnitude, 0x477fe000u);
    // Units of the last place: 2^-10 of the power of two below the number, and 2^-24 below the normal halves.
    uint exponent = max(magnitude >> 23, 113u);
    float units = uintBitsToFloat(magnitude) * uintBitsToFloat(264u - exponent << 23), whole = floor(units);
    // Exact: the part that is cut off is compared, not added.
    bool up = (units - whole) * 8192.0 >= float(8192u - random);
    return sign | (exponent - 113u << 10) + uint(whole) + uint(up);
}

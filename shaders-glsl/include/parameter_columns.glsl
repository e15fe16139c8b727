// Columns of the buffer `parameters`, which is declared before, of uvec4. Included after gaussian.glsl.

#ifndef PARAMETER_COLUMNS_GLSL
#define PARAMETER_COLUMNS_GLSL
#include "half.glsl"

vec4 parameter_column(uint i, uint column) { return uintBitsToFloat(parameters[column_of(i, column)]); }

// Column `c` of the harmonics. In compact storage two of them share 16 bytes, which the first one reads for both: `pair`
// holds them from call to call.
vec4 harmonic_column(inout uvec4 pair, uint i, uint c) {
    if (!COMPACT) return parameter_column(i, HARMONICS + c);
    if (c % 2u == 0u) pair = parameters[column_of(i, HARMONICS + c / 2u)];
    uvec2 words = c % 2u == 0u ? pair.xy : pair.zw;
    return vec4(unpack_halves(words.x), unpack_halves(words.y));
}

#endif

// Reading and writing of the columns that Adam moves: the buffers `parameters`, `first_moments` and `second_moments`, of
// uvec4, are declared before. Compact storage rounds at random what it writes (rounding.glsl), except for parameters that are
// no harmonics. It keeps both moments of a column side by side in `first_moments`, and `second_moments` unused.

#include "parameter_columns.glsl"
#include "rounding.glsl"

void read_moments(uint i, uint column, out vec4 first, out vec4 second) {
    uint at = moments_of(i, column);
    uvec4 words = first_moments[at];
    if (COMPACT) {
        uvec2 a = words.xy, b = words.zw;
        first = vec4(first_of(a.x & 0xffffu), first_of(a.x >> 16), first_of(a.y & 0xffffu), first_of(a.y >> 16));
        second = vec4(second_of(b.x & 0xffffu), second_of(b.x >> 16), second_of(b.y & 0xffffu), second_of(b.y >> 16));
    } else {
        first = uintBitsToFloat(words);
        second = uintBitsToFloat(second_moments[at]);
    }
}

void write_moments(uint i, uint column, uint key, vec4 first, vec4 second) {
    uint at = moments_of(i, column);
    if (COMPACT) {
        uvec4 a, b;
        [[unroll]] for (uint j = 0u; j < 4u; ++j) {
            uint random = rounding_bits(key, column, j);
            a[j] = round_first(first[j], random);
            b[j] = round_second(second[j], random);
        }
        first_moments[at] = uvec4(a.x | a.y << 16, a.z | a.w << 16, b.x | b.y << 16, b.z | b.w << 16);
    } else {
        first_moments[at] = floatBitsToUint(first);
        second_moments[at] = floatBitsToUint(second);
    }
}

// Writes a column of the parameters that compact storage keeps in 32 bits.
void write_column(uint i, uint column, vec4 values) { parameters[column_of(i, column)] = floatBitsToUint(values); }

// Writes column `c` of the harmonics.
void write_harmonics(uint i, uint c, uint key, vec4 values) {
    if (!COMPACT) {
        write_column(i, HARMONICS + c, values);
        return;
    }
    uvec4 halves;
    [[unroll]] for (uint j = 0u; j < 4u; ++j) {
        uint random = rounding_bits(key, HARMONICS + c, 4u + j / 2u);
        halves[j] = round_half(values[j], j % 2u == 0u ? random & 0x1fffu : random >> 19);
    }
    uint at = column_of(i, HARMONICS + c / 2u), first = 2u * (c % 2u);
    parameters[at][first] = halves.x | halves.y << 16;
    parameters[at][first + 1u] = halves.z | halves.w << 16;
}

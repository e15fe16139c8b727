// Scale of the fixed-point gradients of the visibility field's tables: a power of two for which the largest possible
// sum fits 63 bits. An entry collects at most `pixels` times the largest gradient of a feature. That gradient is at most
// the largest gradient of a row times a column of the first layer.
#version 460
#include "common.glsl"
#include "visibility_grid.glsl"

layout(constant_id = 0) const uint WORKGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint LEVELS = 16;

layout(scalar) uniform FieldBlock { FieldStep field; } params;

IN(float, mlp);
IN(uint, extent);
OUT(float, scale); // the power, and its inverse

shared float columns[2u * LEVELS];

void main() {
    for (uint k = gl_LocalInvocationID.x; k < 2u * LEVELS; k += WORKGROUP) {
        float sum = 0.0;
        for (uint n = 0u; n < 32u; n++) sum += abs(mlp[n * (2u * LEVELS + 4u) + k]);
        columns[k] = sum;
    }
    barrier();
    if (gl_LocalInvocationID.x != 0u) return;
    float most = 0.0;
    for (uint k = 0u; k < 2u * LEVELS; k++) most = max(most, columns[k]);
    // Exponents that the numbers are below, with one to spare for rounding.
    int pixels = findMSB(max(params.field.pixels, 1u)) + 1;
    int row, column;
    frexp(uintBitsToFloat(extent[0]), row);
    frexp(most, column);
    int power = clamp(61 - pixels - row - column, -120, 120);
    scale[0] = ldexp(1.0, power);
    scale[1] = ldexp(1.0, -power);
}

// Scale of the fixed-point gradients of the visibility field's tables: a power of two for which the largest possible
// sum fits 63 bits. An entry collects at most `pixels` times the largest gradient of a feature. That gradient is at most
// the largest gradient of a row times a column of the first layer.
#version 460
#include "common.glsl"
#include "visibility_grid.glsl"

layout(constant_id = 0) const uint WORKGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint LEVELS = 16;

layout(push_constant, scalar) uniform Push {
    uint first; // of the extents
    uint count;
    uint parts; // rows of a pixel, which add up
} push;

layout(scalar) uniform FieldBlock { FieldStep field; } params;

IN(float, mlp);
IN(float, extents); // largest magnitudes of parts of the rows' gradients
OUT(float, scale); // the power, and its inverse

shared float columns[2u * LEVELS];
shared float largest[WORKGROUP];

void main() {
    for (uint k = gl_LocalInvocationID.x; k < 2u * LEVELS; k += WORKGROUP) {
        float sum = 0.0;
        for (uint n = 0u; n < 32u; n++) sum += abs(mlp[n * (2u * LEVELS + 4u) + k]);
        columns[k] = sum;
    }
    float own = 0.0;
    for (uint i = gl_LocalInvocationID.x; i < push.count; i += WORKGROUP) own = max(own, extents[push.first + i]);
    largest[gl_LocalInvocationID.x] = own;
    barrier();
    if (gl_LocalInvocationID.x != 0u) return;
    float extent = 0.0;
    for (uint i = 0u; i < WORKGROUP; i++) extent = max(extent, largest[i]);
    extent = min(extent * float(push.parts), 3e38); // whose exponent is that of the largest float: frexp of infinity is undefined
    float most = 0.0;
    for (uint k = 0u; k < 2u * LEVELS; k++) most = max(most, columns[k]);
    // Exponents that the numbers are below, with one to spare for rounding.
    int pixels = findMSB(max(params.field.pixels, 1u)) + 1;
    int row, column;
    frexp(extent, row);
    frexp(most, column);
    int power = clamp(61 - pixels - row - column, -120, 120);
    scale[0] = ldexp(1.0, power);
    scale[1] = ldexp(1.0, -power);
}

// Computes the mean features of a region, its size, and its majority class (lowest index on ties). One workgroup.
#version 460
#include "common.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;

layout(push_constant, scalar) uniform Push { uint groups; } push;

IN(float, region_sums);
IN(uint, histogram);
OUT(Region, region);

shared float totals[AUGMENTED];

void main() {
    for (uint k = gl_LocalInvocationID.x; k < AUGMENTED; k += WORKGROUP) {
        float sum = 0.0;
        // Sums of sums lose less precision. Differences of means may be smaller than the rounding error of one long
        // sum.
        for (uint first = 0u; first < push.groups; first += 16u) {
            float some = 0.0;
            for (uint g = first; g < min(first + 16u, push.groups); g++) some += region_sums[g * AUGMENTED + k];
            sum += some;
        }
        totals[k] = sum;
    }
    barrier();
    for (uint k = gl_LocalInvocationID.x; k < FEATURES; k += WORKGROUP) {
        region[0].mean[k] = totals[k] / max(totals[FEATURES], 1.0);
    }
    if (gl_LocalInvocationID.x != 0u) return;
    region[0].count = totals[FEATURES];
    uint most = 0u, label = 0u;
    for (uint c = 0u; c < CLASSES; c++) {
        if (histogram[c] > most) {
            most = histogram[c];
            label = c;
        }
    }
    region[0].majority = label;
}

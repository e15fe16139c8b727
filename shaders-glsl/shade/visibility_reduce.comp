// Sums the workgroups' gradients of the visibility field's layers in a fixed order.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint LEVELS = 16;
layout(constant_id = 3) const uint STRIPES = 1; // of the sets, added up by as many invocations

layout(push_constant, scalar) uniform Push {
    uint pairs;  // sets of sums of visibility_bwd
    uint points; // of visibility_encode_bwd
} push;

IN(float, sums_of);
IN(float, feature_sums);
OUT(float, mlp_gradient);

const uint WIDTH = 32u;
const uint FEATURES = 2u * LEVELS;
const uint INPUTS = FEATURES + 4u;
const uint SECOND = WIDTH * INPUTS;
const uint LAST = SECOND + WIDTH * WIDTH;

const uint TOGETHER = WORKGROUP / STRIPES; // weights of a workgroup

shared float parts[WORKGROUP];

void main() {
    uint i = gl_WorkGroupID.x * TOGETHER + gl_LocalInvocationID.x % TOGETHER;
    uint stripe = gl_LocalInvocationID.x / TOGETHER;
    bool exists = i < LAST + WIDTH;
    i = min(i, LAST + WIDTH - 1u);
    uint input_ = i % INPUTS, row = i / INPUTS;
    bool of_feature = i < SECOND && input_ < FEATURES;
    uint at;
    if (i >= LAST) at = WIDTH * (WIDTH + 4u) + i - LAST;
    else if (i >= SECOND) at = i - SECOND;
    else at = of_feature ? row * FEATURES + input_ : WIDTH * (WIDTH + input_ - FEATURES) + row;
    float sum = 0.0;
    if (of_feature) {
        for (uint g = stripe; g < push.points; g += STRIPES) sum += feature_sums[g * WIDTH * FEATURES + at];
    } else {
        for (uint g = stripe; g < push.pairs; g += STRIPES) sum += sums_of[g * WIDTH * (WIDTH + 5u) + at];
    }
    if (STRIPES > 1u) {
        parts[gl_LocalInvocationID.x] = sum;
        barrier();
        for (uint s = 1u; s < STRIPES; s++) sum += parts[min(gl_LocalInvocationID.x + s * TOGETHER, WORKGROUP - 1u)];
    }
    if (exists && stripe == 0u) mlp_gradient[i] = sum;
}

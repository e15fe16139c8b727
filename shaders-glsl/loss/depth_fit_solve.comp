// Solves the fit of a view's prior depths. One workgroup. The result is zero where no line with a positive slope fits.
#version 460
#include "common.glsl"
#include "finite.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool SHIFT = false; // whether the line may miss the origin

#define SUM_T vec4
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    uint count; // workgroups that wrote sums
} push;

IN(vec4, sums);   // see depth_fit.comp
OUT(float, line); // slope and offset

// Smallest variance of the priors of which a slope is computed. They are stored with a variance of about 1.
const float LEAST_VARIANCE = 1e-4;

void main() {
    vec4 sum = vec4(0.0);
    float product = 0.0;
    for (uint i = gl_LocalInvocationID.x; i < push.count; i += WORKGROUP) {
        sum += sums[2u * i];
        product += sums[2u * i + 1u].x;
    }
    sum = group_sum(sum);
    barrier(); // before the shared sums are written again
    product = group_sum(vec4(product)).x;
    if (gl_LocalInvocationID.x != 0u) return;
    float slope = 0.0, offset = 0.0;
    if (sum.x > 0.0) {
        vec4 mean = vec4(sum.yzw, product) / sum.x; // x, y, x x, x y
        if (SHIFT) {
            float variance = mean.z - mean.x * mean.x;
            if (variance > LEAST_VARIANCE) slope = (mean.w - mean.x * mean.y) / variance;
            offset = mean.y - slope * mean.x;
        } else if (mean.z > 0.0) {
            slope = mean.w / mean.z;
        }
    }
    bool fits = slope > 0.0 && finite_bits(slope) && finite_bits(offset);
    line[0] = fits ? slope : 0.0;
    line[1] = fits ? offset : 0.0;
}

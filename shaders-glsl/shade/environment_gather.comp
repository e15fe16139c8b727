// Adds a step's gradients of the filtered texels to those of earlier steps, as environment_collect; for an environment
// map that is updated every N steps.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 3) const int FIXED_BITS = 30;

layout(push_constant, scalar) uniform Push {
    uint texels;
    float share; // of a step in the mean
} push;

IN(uvec2, texel_sums);    // [texels * 3] low and high words
IN(uint, largest);        // [1]
IN(float, inverse_sums);  // [texels]
INOUT(float, gathered);   // [texels * 3]

#include "fixed.glsl"

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= 3u * push.texels) return;
    float unit = power_of_two(-fixed_exponent(largest[0]));
    gathered[i] += push.share * from_fixed(texel_sums[i], unit) * inverse_sums[i / 3u];
}

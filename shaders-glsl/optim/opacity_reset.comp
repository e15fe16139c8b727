// Clamps opacities to 0.01 and clears their moments (Kerbl et al. 2023, section 5.2: floaters near the cameras fade, and
// needed Gaussians recover).
#version 460
#include "common.glsl"
#include "work.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, live);
INOUT(vec4, parameters);
INOUT(uvec4, first_moments);
INOUT(uvec4, second_moments);

const float LOGIT = -4.5951198501345898; // of 0.01

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= live[0].count) return;
    uint at = column_of(i, 0u);
    if (!(parameters[at].w <= LOGIT)) parameters[at].w = LOGIT; // NaN as well
    uint moments = moments_of(i, 0u);
    if (COMPACT) {
        // The upper halves of the words: the last of the four first moments, and of the second.
        first_moments[moments].y &= 0xffffu;
        first_moments[moments].w &= 0xffffu;
    } else {
        first_moments[moments].w = second_moments[moments].w = 0u;
    }
}

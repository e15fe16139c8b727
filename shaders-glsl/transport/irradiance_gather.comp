// Irradiance of every Gaussian: a weighted sum over its nearest surfels; and its gain. An invocation per Gaussian.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const bool GAINS = false; // without them gains are 1
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint gaussians;
    uint receivers;
    uint lights; // of the irradiance, whose first counts
} push;

const uint NEIGHBORS = 8u;

IN(uint, neighbors);         // [Gaussians][8]
IN(float, neighbor_weights); // [Gaussians][8]
IN(vec3, irradiance);        // [receivers][lights]
IN(float, log_gains);        // [Gaussians]
OUT(vec4, values);           // [Gaussians]: red, green, blue, gain

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= push.gaussians) return;
    vec3 sum = vec3(0.0);
    [[unroll]] for (uint k = 0u; k < NEIGHBORS; k++) {
        uint from = neighbors[i * NEIGHBORS + k];
        // No surfel.
        if (from < push.receivers) sum += neighbor_weights[i * NEIGHBORS + k] * irradiance[from * push.lights];
    }
    values[i] = vec4(sum, GAINS ? exp(log_gains[i]) : 1.0);
}

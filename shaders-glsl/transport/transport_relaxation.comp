// Weights of Chebyshev's iteration, for a spectral radius that is the root mean square of the reflectance. One workgroup.
//
// With a uniform reflectance in a closed room, this is the spectral radius. If it is larger or smaller, iterations converge
// as long as those of Jacobi do.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint stride;     // between the receivers that count
    uint iterations;
    float share;     // of the spectral radius: the focus of the ellipse of eigenvalues; 0: Jacobi's iteration
} push;

IN(vec3, reflectance);  // [receivers]
OUT(float, relaxation); // [iterations]

shared vec3 sums[WORKGROUP];

void main() {
    uint lane = gl_LocalInvocationID.x;
    vec3 sum = vec3(0.0);
    for (uint i = lane * push.stride; i < push.receivers; i += WORKGROUP * push.stride) {
        sum += reflectance[i] * reflectance[i];
    }
    sums[lane] = sum;
    barrier();
    [[unroll]] for (uint half_ = WORKGROUP / 2u; half_ > 0u; half_ /= 2u) {
        if (lane < half_) sums[lane] += sums[lane + half_];
        barrier();
    }
    if (lane != 0u) return;
    vec3 mean = sums[0] / float((push.receivers + push.stride - 1u) / push.stride);
    float square = push.share * push.share * max(max(mean.x, mean.y), mean.z);
    // Not a number: 0.
    square = square > 0.0 ? min(square, 0.998) : 0.0;
    float weight = 1.0;
    for (uint k = 0u; k < by_workgroup(push.iterations); k++) {
        relaxation[k] = weight;
        weight = 1.0 / (1.0 - square * weight * (k == 0u ? 0.5 : 0.25));
    }
}

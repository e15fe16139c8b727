// Gradient of the receivers' irradiance from that of the Gaussians: a column of the matrix of weights times the gradients.
//
// Eight lanes share a receiver whatever the subgroup, so that the order of the sum is the same on every device.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint receivers; } push;

const uint LANES = 8u;

IN(uint, column_starts);        // [receivers + 1]
IN(uint, column_gaussians);     // Gaussians of each column
IN(float, column_weights);
IN(vec4, values_gradient);      // [Gaussians]
OUT(vec3, irradiance_gradient); // [receivers]

void main() {
    uint lane = gl_SubgroupInvocationID % LANES, mine = gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
    uint receiver = folded_workgroup() * (WORKGROUP / LANES) + mine / LANES;
    bool real = receiver < push.receivers;
    receiver = min(receiver, push.receivers - 1u);
    vec3 sum = vec3(0.0);
    uint end = column_starts[receiver + 1u];
    for (uint e = column_starts[receiver] + lane; e < end; e += 4u * LANES) {
        [[unroll]] for (uint k = 0u; k < 4u; k++) {
            bool there = e + k * LANES < end;
            uint at = there ? e + k * LANES : e;
            float weight = there ? column_weights[at] : 0.0;
            sum += weight * values_gradient[column_gaussians[at]].xyz;
        }
    }
    [[unroll]] for (uint other = LANES / 2u; other > 0u; other /= 2u) {
        uint from = gl_SubgroupInvocationID ^ other;
        sum += vec3(subgroupShuffle(sum.x, from), subgroupShuffle(sum.y, from), subgroupShuffle(sum.z, from));
    }
    if (real && lane == 0u) irradiance_gradient[receiver] = sum;
}

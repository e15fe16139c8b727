// Gradients of the Gaussians' irradiance and gain: a column of the sparse matrix times the pixels' gradients.
//
// A pull towards gain 1 adds to the gain's gradient. Eight lanes share a Gaussian whatever the subgroup, so that the order of the
// sum is the same on every device.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
#include "entry_weights.glsl"

layout(push_constant, scalar) uniform Push {
    uint gaussians;
    float pull; // weight of the mean square of the pixels' log gains
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, column_starts); // [Gaussians + 1]
IN(uint, rows);
IN(uint, row_weights);
IN(vec4, irradiance_gradient); // [pixels]: irradiance, gain
IN(float, log_gains);          // [Gaussians]
OUT(vec4, values_gradient);    // [Gaussians]: irradiance, gain
OUT(float, gains_gradient);    // [Gaussians]: by log gain

const uint LANES = 8u;

ENTRY_WEIGHTS(row_weight_of, row_weights)

void main() {
    uint lane = gl_SubgroupInvocationID % LANES, mine = gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
    uint i = folded_workgroup() * (WORKGROUP / LANES) + mine / LANES;
    bool real = i < push.gaussians;
    i = min(i, push.gaussians - 1u);
    vec4 sum = vec4(0.0);
    float seen = 0.0;
    uint end = column_starts[i + 1u];
    for (uint e = column_starts[i] + lane; e < end; e += 4u * LANES) {
        [[unroll]] for (uint k = 0u; k < 4u; ++k) {
            bool there = e + k * LANES < end;
            uint at = there ? e + k * LANES : e;
            float w = there ? row_weight_of(at) : 0.0;
            sum += w * irradiance_gradient[rows[at]];
            seen += w;
        }
    }
    [[unroll]] for (uint other = LANES / 2u; other > 0u; other /= 2u) {
        uint from = gl_SubgroupInvocationID ^ other;
        sum += vec4(subgroupShuffle(sum.x, from), subgroupShuffle(sum.y, from), subgroupShuffle(sum.z, from),
                    subgroupShuffle(sum.w, from));
        seen += subgroupShuffle(seen, from);
    }
    if (!real || lane != 0u) return;
    float pixels = float(params.step.camera.size.x * params.step.camera.size.y);
    values_gradient[i] = sum;
    gains_gradient[i] = sum.w * exp(log_gains[i]) + 2.0 * push.pull * seen / pixels * log_gains[i];
}

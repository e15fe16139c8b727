// Gradients of the Gaussians' raw materials: a column of the sparse matrix times the pixels' gradients.
//
// Eight lanes share a Gaussian whatever the subgroup, each adding every eighth entry, so that the order of the sum is the
// same on every device. Four entries an iteration keep the iterations of the largest splats within llvmpipe's limit (65535).
#version 460
#include "common.glsl"
#include "material.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const bool METALLIC = false;
layout(constant_id = 2) const bool ADD = false; // to the gradients of other views of the step
layout(local_size_x_id = 0) in;
#include "entry_weights.glsl"

IN(uint, column_starts); // [Gaussians + 1]
IN(uint, rows);
IN(uint, row_weights);
IN(vec4, materials_gradient); // [pixels]
IN(float, metallic_gradient);
IN(vec3, albedo);             // raw
IN(float, roughness);
IN(float, metallic);
INOUT(vec3, grad_albedo);     // by raw
INOUT(float, grad_roughness);
INOUT(float, grad_metallic);

const uint LANES = 8u;

ENTRY_WEIGHTS(row_weight_of, row_weights)

void main() {
    uint lane = gl_SubgroupInvocationID % LANES;
    uint mine = gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
    uint i = folded_workgroup() * (WORKGROUP / LANES) + mine / LANES;
    bool real = i < grad_roughness.length();
    i = min(i, grad_roughness.length() - 1u);
    vec4 sum = vec4(0.0);
    float metal = 0.0;
    uint end = column_starts[i + 1u];
    for (uint e = column_starts[i] + lane; e < end; e += 4u * LANES) {
        [[unroll]] for (uint k = 0u; k < 4u; ++k) {
            bool there = e + k * LANES < end;
            uint at = there ? e + k * LANES : e;
            float w = there ? row_weight_of(at) : 0.0;
            uint p = rows[at];
            sum += w * materials_gradient[p];
            if (METALLIC) metal += w * metallic_gradient[p];
        }
    }
    [[unroll]] for (uint other = LANES / 2u; other > 0u; other /= 2u) {
        uint from = gl_SubgroupInvocationID ^ other;
        sum += vec4(subgroupShuffle(sum.x, from), subgroupShuffle(sum.y, from), subgroupShuffle(sum.z, from),
                    subgroupShuffle(sum.w, from));
        if (METALLIC) metal += subgroupShuffle(metal, from);
    }
    if (!real || lane != 0u) return;
    vec3 a = albedo[i];
    vec3 by_albedo = ALBEDO_RANGE * sum.xyz * vec3(sigmoid_slope(a.x), sigmoid_slope(a.y), sigmoid_slope(a.z));
    float by_roughness = ROUGHNESS_RANGE * sum.w * sigmoid_slope(roughness[i]);
    if (METALLIC) metal *= sigmoid_slope(metallic[i]);
    if (ADD) {
        by_albedo += grad_albedo[i];
        by_roughness += grad_roughness[i];
        if (METALLIC) metal += grad_metallic[i];
    }
    grad_albedo[i] = by_albedo;
    grad_roughness[i] = by_roughness;
    if (METALLIC) grad_metallic[i] = metal;
}

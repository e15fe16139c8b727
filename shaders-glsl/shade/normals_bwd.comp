// Gradients of the Gaussians' normals: a column of the sparse matrix times the pixels' gradients, each over the length
// before normalization.
//
// Eight lanes share a Gaussian whatever the subgroup, each adding every eighth entry, so that the order of the sum is the
// same on every device. Four entries an iteration keep the iterations of the largest splats within llvmpipe's limit (65535).
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
#include "entry_weights.glsl"

IN(uint, column_starts); // [Gaussians + 1]
IN(uint, rows);
IN(uint, row_weights);
IN(vec3, normals_gradient); // [pixels], of unit normals and across them
IN(float, inverse_lengths); // [pixels]
OUT(vec3, grad_normals);    // [Gaussians]

const uint LANES = 8u;

ENTRY_WEIGHTS(row_weight_of, row_weights)

void main() {
    uint lane = gl_SubgroupInvocationID % LANES;
    uint mine = gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
    uint i = folded_workgroup() * (WORKGROUP / LANES) + mine / LANES;
    uint count = column_starts.length() - 1u;
    bool real = i < count;
    i = min(i, count - 1u);
    vec3 sum = vec3(0.0);
    uint end = column_starts[i + 1u];
    for (uint e = column_starts[i] + lane; e < end; e += 4u * LANES) {
        [[unroll]] for (uint k = 0u; k < 4u; ++k) {
            bool there = e + k * LANES < end;
            uint at = there ? e + k * LANES : e;
            uint p = rows[at];
            float w = there ? row_weight_of(at) * inverse_lengths[p] : 0.0;
            sum += w * normals_gradient[p];
        }
    }
    [[unroll]] for (uint other = LANES / 2u; other > 0u; other /= 2u) {
        uint from = gl_SubgroupInvocationID ^ other;
        sum += vec3(subgroupShuffle(sum.x, from), subgroupShuffle(sum.y, from), subgroupShuffle(sum.z, from));
    }
    if (real && lane == 0u) grad_normals[i] = sum;
}

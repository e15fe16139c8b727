// Materials of every pixel: a row of the sparse matrix times the Gaussians' values.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const bool METALLIC = false;
layout(local_size_x_id = 0) in;
#include "entry_weights.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, row_starts); // [pixels + 1]
IN(uint, columns);
IN(uint, weights);
IN(vec4, values);     // [Gaussians]
IN(float, metallic_values);
OUT(vec4, materials); // [pixels]
OUT(float, metallic);

ENTRY_WEIGHTS(weight_of, weights)

void main() {
    uint p = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uvec2 size = params.step.camera.size;
    if (p >= size.x * size.y) return;
    vec4 sum = vec4(0.0);
    float metal = 0.0;
    // Rows that did not fit were not written.
    uint end = min(row_starts[p + 1u], columns.length());
    for (uint e = row_starts[p]; e < end; ++e) {
        float w = weight_of(e);
        uint g = columns[e];
        sum += w * values[g];
        if (METALLIC) metal += w * metallic_values[g];
    }
    materials[p] = sum;
    if (METALLIC) metallic[p] = metal;
}

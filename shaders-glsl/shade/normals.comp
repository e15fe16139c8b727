// Normals of every pixel where Gaussians have learned normals: a row of the sparse matrix times the normals, normalized.
//
// Also writes the inverse length, which the backward pass needs.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
#include "entry_weights.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, row_starts); // [pixels + 1]
IN(uint, columns);
IN(uint, weights);
IN(vec3, gaussian_normals); // [Gaussians], of any length
OUT(vec3, normals);         // [pixels], unit or zero
OUT(float, inverse_lengths); // [pixels], zero where the normal is

ENTRY_WEIGHTS(weight_of, weights)

void main() {
    uint p = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uvec2 size = params.step.camera.size;
    if (p >= size.x * size.y) return;
    vec3 sum = vec3(0.0);
    // Rows that did not fit were not written.
    uint end = min(row_starts[p + 1u], columns.length());
    for (uint e = row_starts[p]; e < end; ++e) sum += weight_of(e) * gaussian_normals[columns[e]];
    // Scaled first: neither tiny nor huge ones leave the range of floats.
    float largest = max(max(abs(sum.x), abs(sum.y)), abs(sum.z));
    vec3 normal = vec3(0.0);
    float inverse = 0.0;
    if (largest > 1e-20 && largest < 1e30) {
        vec3 scaled = sum / largest;
        float by = inversesqrt(dot(scaled, scaled));
        normal = by * scaled;
        // Where normals all but cancel, their direction is anybody's guess, and nothing is to be learned of it.
        if (largest > 1e-3) inverse = by / largest;
    }
    normals[p] = normal;
    inverse_lengths[p] = inverse;
}

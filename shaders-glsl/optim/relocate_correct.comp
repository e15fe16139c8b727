// Relocation, step 5: corrects the drawn Gaussians before they are copied. All copies together then look like the one before
// them. Clears the moments of the drawn Gaussian.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"
#include "relocate.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(Work, before);
IN(uint, copies);
INOUT(vec4, parameters);
INOUT(uvec4, first_moments);
INOUT(uvec4, second_moments);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= before[0].count || copies[i] == 0u) return;
    uint place = column_of(i, 0u), size = column_of(i, 1u);
    vec2 now = relocated(parameters[place].w, float(copies[i]) + 1.0, params.densify.prune_opacity);
    parameters[place].w = now.x;
    parameters[size].xyz += now.y;
    for (uint column = 0u; column < MOMENT_COLUMNS; ++column) {
        uint at = moments_of(i, column);
        first_moments[at] = uvec4(0u);
        if (!COMPACT) second_moments[at] = uvec4(0u);
    }
}

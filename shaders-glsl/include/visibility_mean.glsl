// Body of kernels that write the visibility of the lights from each pixel: the mean over lights, or one of them.
#include "common.glsl"
#include "coverage.glsl"
#include "visibility_grid.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint SUBGROUP = 32;
layout(constant_id = 3) const bool FIELD_SPREAD = false; // see visibility_field.glsl
layout(constant_id = 4) const uint LEVELS = 16;
#ifndef MATRIX_UNITS
layout(constant_id = 5) const bool SPLIT = true;   // false: recomputes the first layer for each light, for comparison
#endif
layout(constant_id = 6) const uint ONE = 0xffffffffu; // a light, instead of the mean over all

layout(scalar) uniform FieldBlock { FieldStep field; } params;

IN(FieldLevel, field_levels);
#include "visibility_tables.glsl"
IN(float, mlp);
#include "visibility_weights.glsl" // the same
IN(vec3, light_positions); // world
IN(vec3, points);
IN(float, coverage);
OUT(float, visibility);

#include "visibility_field.glsl"

void main() {
    field_weights();
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    bool within = pixel < params.field.pixels;
    uint at = within ? pixel : 0u;
    vec3 point = field_inside(params.field, points[at]), position = field_position(params.field, point);
    field_pixel(position);
    uint begin = ONE == 0xffffffffu ? 0u : ONE, end = ONE == 0xffffffffu ? by_workgroup(params.field.lights) : ONE + 1u;
    float sum = 0.0;
    [[dont_unroll]] for (uint j = begin; j < end; j += FIELD_TOGETHER) {
#ifndef MATRIX_UNITS
        if (!SPLIT) {
            // Never true, but opaque to the compiler, which would otherwise hoist it out of the loop over lights.
            bool never = gl_NumWorkGroups.z > j + 2u;
            if (FIELD_SPREAD) {
                if (never) field_features[j % FIELD_FEATURES] = 0.0;
                EACH_ITEM(spread_project)
            } else {
                if (never) position.x = 0.0;
                field_pixel(position);
            }
        }
#endif
        vec4 ways[FIELD_TOGETHER];
        float seen[FIELD_TOGETHER];
        FIELD_EACH(t, FIELD_TOGETHER) {
            vec3 light = light_positions[min(j + t, end - 1u)];
            ways[t] = field_way(params.field, point, field_inside(params.field, light));
        }
        field_visibilities(ways, seen);
        FIELD_EACH(t, FIELD_TOGETHER) sum += j + t < end ? seen[t] : 0.0;
    }
    bool shaded = is_covered(coverage[at]);
    if (within) visibility[pixel] = shaded ? sum / float(max(end - begin, 1u)) : 0.0;
}

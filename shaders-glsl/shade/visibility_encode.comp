// Hash-grid encoding of the visibility field: the first layer's response to each pixel's point, and to the jittered
// point. Rows of 32 by pixel, so that later kernels can visit lights in any order without reading the tables again.
#version 460
#include "common.glsl"
#include "random.glsl"
#include "visibility_grid.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint SUBGROUP = 32;
layout(constant_id = 3) const bool FIELD_SPREAD = false; // see visibility_field.glsl
layout(constant_id = 4) const uint LEVELS = 16;
layout(constant_id = 5) const bool BY_BLOCK = false; // rows of SUBGROUP pixels side by side: 32 x SUBGROUP instead of SUBGROUP x 32

layout(push_constant, scalar) uniform Push {
    uint first; // pixel
    uint count;
    uint moved; // 1: of the moved points, 0: as they are
} push;

layout(scalar) uniform FieldBlock { FieldStep field; } params;

IN(FieldLevel, field_levels);
#include "visibility_tables.glsl"
IN(float, mlp);
#include "visibility_weights.glsl" // the same
IN(vec3, points);
OUT(float, rows); // count x 32, or whole blocks

#include "visibility_field.glsl"
#include "visibility_jitter.glsl"

// Number n of the row of an invocation's pixel.
uint row_number(uint i, uint n) {
    return BY_BLOCK ? (i / SUBGROUP * WIDTH + n) * SUBGROUP + i % SUBGROUP : i * WIDTH + n;
}

void main() {
    field_weights();
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x, pixel = push.first + i;
    bool within = i < push.count && pixel < params.field.pixels;
    uint at = within ? pixel : 0u;
    vec3 point = points[at];
    point += float(push.moved) * jitter_of(params.field, POINTS, at);
    field_respond(field_position(params.field, field_inside(params.field, point)));
    if (FIELD_SPREAD) {
        uint first = i - gl_SubgroupInvocationID;
        [[unroll]] for (uint item = 0u; item < ITEMS; item++) {
            if (first + item < push.count)
                EACH_HELD(h) rows[row_number(first + item, neuron(h))] = spread_points[item * HELD + h];
        }
    } else if (within) {
        FIELD_EACH(n, WIDTH) rows[row_number(i, n)] = field_point[n];
    }
}

// Shadows from the visibility field, one pixel a lane.
#include "visibility_grid.glsl"

layout(constant_id = 10) const uint LEVELS = 16;
layout(constant_id = 11) const bool FIELD_SPREAD = false; // see visibility_field.glsl

layout(scalar) uniform FieldBlock { FieldStep field; } field_params;

IN(FieldLevel, field_levels);
#include "visibility_tables.glsl"
IN(float, mlp);

const uint WORKGROUP = SUBGROUP;
#include "visibility_field.glsl"

vec3 field_point_of;
bool field_ready = false;

void visibility_begin(uint slot, uint pixel) {
    if (!field_ready) field_weights();
    field_ready = true;
    // Where nothing is shaded the point may be no number.
    field_point_of = is_covered(coverage[pixel]) ? field_inside(field_params.field, points[pixel]) : field_params.field.box_min;
    field_pixel(field_position(field_params.field, field_point_of));
}

float visibility(uint slot, uint light) {
    vec3 place = field_inside(field_params.field, prepared[light_at(light)].xyz);
    return field_visibility(field_way(field_params.field, field_point_of, place));
}

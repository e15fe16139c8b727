// Shadows from the visibility field, one pixel a lane.
//
// See lights_pixels.glsl for the three functions. next_light() takes FIELD_TOGETHER lights ahead and evaluates them together.
#include "visibility_grid.glsl"

layout(constant_id = 10) const uint LEVELS = 16;
layout(constant_id = 11) const bool FIELD_SPREAD = false; // see visibility_field.glsl

layout(scalar) uniform FieldBlock { FieldStep field; } field_params;

IN(FieldLevel, field_levels);
#include "visibility_tables.glsl"
IN(float, mlp);
#include "visibility_weights.glsl" // the same

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

// Lights ahead, and what the lane's pixel sees of them.
uint field_lights[FIELD_TOGETHER];
float field_seen[FIELD_TOGETHER];
uint field_held = 0u, field_taken = 0u;

vec4 field_way_from(vec3 place) {
    return field_way(field_params.field, field_point_of, field_inside(field_params.field, place));
}

bool next_light(inout Walk way, out uint light, out vec3 place) {
    if (FIELD_TOGETHER == 1u) return walk(way, light, place);
    if (field_taken == field_held) {
        vec4 ways[FIELD_TOGETHER];
        FIELD_EACH(t, FIELD_TOGETHER) ways[t] = vec4(0.0);
        field_taken = field_held = 0u;
        [[dont_unroll]] for (; field_held < FIELD_TOGETHER && walk(way, light, place); field_held++) {
            vec4 next = field_way_from(place);
            FIELD_EACH(t, FIELD_TOGETHER) {
                if (t == field_held) {
                    field_lights[t] = light;
                    ways[t] = next;
                }
            }
        }
        if (field_held == 0u) return false;
        field_visibilities(ways, field_seen);
    }
    light = field_lights[0];
    FIELD_EACH(t, FIELD_TOGETHER) light = t == field_taken ? field_lights[t] : light;
    place = prepared[light_at(light)].xyz;
    field_taken++;
    return true;
}

float visibility(uint slot, uint light) {
    if (FIELD_TOGETHER == 1u) {
        vec4 ways[FIELD_TOGETHER];
        ways[0] = field_way_from(prepared[light_at(light)].xyz);
        field_visibilities(ways, field_seen);
        return field_seen[0];
    }
    float seen = field_seen[0];
    FIELD_EACH(t, FIELD_TOGETHER) seen = t + 1u == field_taken ? field_seen[t] : seen;
    return seen;
}

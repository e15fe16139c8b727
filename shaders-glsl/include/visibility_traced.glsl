// Traced shadows. Rays begin TRACED_OFFSET above the surface.
//
// See lights_pixels.glsl for the three functions. One pixel a lane is enough, since each pixel traverses the tree by itself.

#include "traced.glsl"

layout(constant_id = 8) const float TRACED_OFFSET = 0.0;

vec3 traced_from[PER_LANE];

void visibility_begin(uint slot, uint pixel) {
    traced_from[slot] = points[pixel] + TRACED_OFFSET * normals[pixel];
}

float visibility(uint slot, uint light) {
    vec3 to = prepared[light_at(light)].xyz - traced_from[slot];
    float square = dot(to, to), inverse = inversesqrt(max(square, 1e-30));
    return traced_transmittance(traced_from[slot], to * inverse, pair_lit ? square * inverse : -1.0);
}

bool next_light(inout Walk way, out uint light, out vec3 place) { return walk(way, light, place); }

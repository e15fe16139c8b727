// Pairs of visibility_bwd.glsl and visibility_bwd_lanes.glsl under lights of constant radiance.
//
// A pair contributes visibility times the light's radiance times the gradient of the pixel's radiance.
#include "common.glsl"
#include "coverage.glsl"
#include "finite.glsl"
#include "random.glsl"
#include "visibility_grid.glsl"
#include "visibility_jitter.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
#include "visibility_bwd_interface.glsl"

IN(vec3, light_positions); // world
IN(vec3, light_radiance);
IN(vec3, radiance_gradient);

vec3 pixel_gradient;

uint light_count() { return by_workgroup(field_params.field.lights); }

uint light_of(uint i) { return i; }

vec3 light_place(uint light) { return light_positions[light]; }

void pair_begin(uint pixel, bool is_shaded) { pixel_gradient = is_shaded ? radiance_gradient[pixel] : vec3(0.0); }

bool pair_matters(uint light) { return dot(pixel_gradient, light_radiance[light]) != 0.0; }

float pair_gradient(uint light) { return dot(pixel_gradient, light_radiance[light]); }

// Visibility of a list of points from every pixel through the Gaussians. Rows of workgroups are points.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint SUBGROUP = 32;

#include "traced.glsl"

layout(push_constant, scalar) uniform Push {
    uint groups;  // workgroups for each place
    uint places;
    uint pixels;  // of a row of the result
    float offset; // of rays' begin above the surface
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, points);      // [P * 3]
IN(float, normals);     // [P * 3]
IN(float, coverage);    // [P]
IN(float, places);      // [places * 3]
OUT(float, visibility); // [places * P]

vec3 triple(uint i, bool of_points) {
    return of_points ? vec3(points[3u * i], points[3u * i + 1u], points[3u * i + 2u])
                     : vec3(normals[3u * i], normals[3u * i + 1u], normals[3u * i + 2u]);
}

void main() {
    uint group = folded_workgroup(), place = group / push.groups;
    uint i = group % push.groups * WORKGROUP + gl_LocalInvocationID.x;
    if (place >= push.places) return;
    bool here = i < params.step.camera.size.x * params.step.camera.size.y;
    uint pixel = here ? i : 0u;
    bool surface = here && is_covered(coverage[pixel]);
    vec3 from = triple(pixel, true) + push.offset * triple(pixel, false);
    vec3 to = vec3(places[3u * place], places[3u * place + 1u], places[3u * place + 2u]) - from;
    float square = dot(to, to), inverse = inversesqrt(max(square, 1e-30));
    float seen = traced_transmittance(from, to * inverse, surface ? square * inverse : -1.0);
    if (here) visibility[place * push.pixels + i] = surface ? seen : 0.0;
}

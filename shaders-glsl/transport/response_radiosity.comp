// Radiosity of every receiver, as a radiance: reflectance / pi times all irradiance. Direct irradiance is that of color 1 by
// emitter times the colors, added in the order of the emitters.
//
// An invocation per receiver. Emitters of color 0 are skipped; their irradiance is not read.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint lights;
} push;

IN(float, unit);        // [lights][receivers]: direct irradiance by color 1
IN(vec3, light_colors); // [lights]
IN(vec3, irradiance);   // [receivers]: that bounces
IN(vec3, reflectance);  // [receivers]
OUT(vec3, radiosity);   // [receivers]

const float PI = 3.14159265358979;

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= push.receivers) return;
    vec3 sum = irradiance[i];
    for (uint light = 0u; light < by_workgroup(push.lights); light++) {
        vec3 color = light_colors[light];
        if (color != vec3(0.0)) sum += color * unit[light * push.receivers + i];
    }
    radiosity[i] = reflectance[i] / PI * sum;
}

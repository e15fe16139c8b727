// Irradiance of every receiver: responses to the emitters times their colors, added in the order of the emitters.
//
// An invocation per receiver. Emitters of color 0 are skipped; their responses are not read.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint lights;
} push;

IN(vec3, responses);    // [lights][receivers]: irradiance by color 1
IN(vec3, light_colors); // [lights]
OUT(vec3, irradiance);  // [receivers]

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= push.receivers) return;
    vec3 sum = vec3(0.0);
    for (uint light = 0u; light < by_workgroup(push.lights); light++) {
        vec3 color = light_colors[light];
        if (color != vec3(0.0)) sum += color * responses[light * push.receivers + i];
    }
    irradiance[i] = sum;
}

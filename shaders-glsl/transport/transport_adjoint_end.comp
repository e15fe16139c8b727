// Gradients by the source and by the reflectance, from what the last adjoint iteration gathered. An invocation for each
// receiver.
#version 460
#include "common.glsl"
#include "transport_images.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(constant_id = 1) const bool BY_RADIOSITY = true;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint lights;
    uint rows; // of an image of a light
    uint iterations;
} push;

#include "transport_report.glsl"
IN(vec3, radiosity_gradient); // [receivers][lights]
IN(vec3, irradiance);         // [receivers][lights], of the solve
layout(rgba32f) uniform restrict readonly image2D gathered;
OUT(vec3, source_gradient);      // [receivers][lights]
OUT(vec3, reflectance_gradient); // [receivers]

void main() {
    uint receiver = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (receiver == 0u) {
        for (uint light = 0u; light < by_workgroup(push.lights); light++) transport_report(light);
    }
    if (receiver >= push.receivers) return;
    vec3 sum = vec3(0.0);
    for (uint light = 0u; light < by_workgroup(push.lights); light++) {
        uint at = receiver * push.lights + light;
        vec3 gradient = imageLoad(gathered, transport_texel(receiver, light, push.rows)).xyz;
        if (BY_RADIOSITY) gradient += radiosity_gradient[at];
        source_gradient[at] = gradient;
        sum += gradient * irradiance[at];
    }
    reflectance_gradient[receiver] = sum * 0.318309886184;
}

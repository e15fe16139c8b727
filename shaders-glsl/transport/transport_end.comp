// Radiosity and irradiance from what the last iteration gathered. An invocation for each receiver and light.
#version 460
#include "common.glsl"
#include "transport_images.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint lights;
    uint rows; // of an image of a light
    uint iterations;
} push;

#include "transport_report.glsl"
IN(vec3, source);      // [receivers][lights]
IN(vec3, reflectance); // [receivers]
layout(rgba32f) uniform restrict readonly image2D gathered;
OUT(vec3, radiosity);  // [receivers][lights]
OUT(vec3, irradiance); // [receivers][lights]

void main() {
    uint at = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (at < push.lights) transport_report(at);
    if (at >= push.receivers * push.lights) return;
    uint receiver = at / push.lights, light = at % push.lights;
    vec3 sum = imageLoad(gathered, transport_texel(receiver, light, push.rows)).xyz;
    radiosity[at] = source[at] + reflectance[receiver] * sum;
    irradiance[at] = 3.14159265359 * sum;
}

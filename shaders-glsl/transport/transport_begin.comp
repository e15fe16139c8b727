// First radiosity of the iteration. See transport_begin.glsl.
#version 460
#include "common.glsl"
#include "transport_images.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
#include "transport_begin.glsl"

IN(vec3, source_values); // [receivers][lights]
IN(vec3, initial);       // [receivers][lights]

vec3 transport_initial(uint receiver, uint light, out vec3 lit) {
    lit = source_values[receiver * push.lights + light];
    return initial[receiver * push.lights + light];
}

// Radiosity of direct light of color 1, the source of a response: reflectance / pi times irradiance. An invocation per
// receiver.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint receivers; } push;

IN(float, unit);       // [receivers]: irradiance by color 1
IN(vec3, reflectance); // [receivers]
OUT(vec3, source);     // [receivers]

const float PI = 3.14159265358979;

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i < push.receivers) source[i] = unit[i] / PI * reflectance[i];
}

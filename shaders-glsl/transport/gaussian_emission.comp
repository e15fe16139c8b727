// Emitted radiance of every Gaussian: that of its emitter. An invocation per Gaussian.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint gaussians;
    uint emitters;
} push;

IN(uint, numbers);  // [Gaussians]: number of the emitter, from 1; 0 for none
IN(vec3, radiance); // [emitters]
OUT(vec4, values);  // [Gaussians]: red, green, blue, 0

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= push.gaussians) return;
    uint number = numbers[i];
    vec3 emitted = vec3(0.0);
    if (number > 0u && number <= push.emitters) emitted = radiance[number - 1u];
    values[i] = vec4(emitted, 0.0);
}

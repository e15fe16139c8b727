// Response to one emitter and its direct light, written among those of all emitters. An invocation per receiver.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const bool DIRECT = false; // whether direct light is stored
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint lights;
} push;

IN(uint, emitter);      // [1]: index of the emitter
IN(vec3, irradiance);   // [receivers]
INOUT(vec3, responses); // [lights][receivers]; those of other emitters stay
IN(float, unit);        // [receivers]: direct irradiance by color 1
INOUT(float, units);    // [lights][receivers]; those of other emitters stay

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i < push.receivers && emitter[0] < push.lights) {
        responses[emitter[0] * push.receivers + i] = irradiance[i];
        if (DIRECT) units[emitter[0] * push.receivers + i] = unit[i];
    }
}

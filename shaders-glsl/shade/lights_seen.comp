// Mean visibility of the active lights over a range of pixels, from the results of lights_trace.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint first;   // pixel of the stretch
    uint stretch; // pixels from one light's to the next one's
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, light_list);
IN(uint, seen);
OUT(float, visibility); // [P]

void main() {
    uint at = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x, pixel = push.first + at;
    bool here = at < push.stretch && pixel < params.step.camera.size.x * params.step.camera.size.y;
    uint sum = 0u, lights = light_list[0];
    for (uint slot = 0u; slot < by_workgroup(lights); slot++) {
        uint byte = light_list[1u + slot] * push.stretch + (here ? at : 0u);
        sum += bitfieldExtract(seen[byte / 4u], int(8u * (byte & 3u)), 8);
    }
    if (here) visibility[pixel] = float(sum) / (255.0 * float(max(lights, 1u)));
}

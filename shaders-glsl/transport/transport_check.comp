// Workgroups of the following iterations: none if the last one of every light changed no value by more than the tolerance.
// Then the following checks do not run either. One invocation.
#version 460
#include "common.glsl"

layout(local_size_x = 1) in;

layout(push_constant, scalar) uniform Push {
    uvec3 groups;
    uint lights;
    uint iteration; // the following one
    float tolerance;
} push;

IN(uint, progress);     // see transport_step.glsl
OUT(uint, dispatches);  // workgroups of iterations, and of the next check; cleared

void main() {
    bool open = false;
    for (uint light = 0u; light < by_workgroup(push.lights); light++) {
        open = open || uintBitsToFloat(progress[(push.iteration + 1u) * push.lights + light]) > push.tolerance;
    }
    [[unroll]] for (uint k = 0u; k < 3u; k++) {
        dispatches[k] = open ? push.groups[k] : 0u;
        dispatches[3u + k] = open ? 1u : 0u;
    }
}

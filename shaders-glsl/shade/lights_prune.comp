// Switches off lights whose largest amplitude is small against the largest of all active lights. One workgroup.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;
layout(constant_id = 2) const bool FREE = false;

layout(push_constant, scalar) uniform Push {
    uint lights;
    float log_share; // log of the share of the largest amplitude that one of a light's must have
} push;

IN(float, lobes);
INOUT(float, gains);

#include "light_axis.glsl"

const float NONE = -1e30;

shared float largest[(WORKGROUP + 7u) / 8u];

float log_amplitude(uint light) {
    float most = NONE;
    if (gains[light] == 0.0) return most;
    for (uint k = 0u; k < LOBES; k++) {
        vec3 a = load_raw_lobe(light * LOBES + k).amplitude;
        most = max(most, max(a.r, max(a.g, a.b)));
    }
    return most;
}

void main() {
    float most = NONE;
    for (uint light = gl_LocalInvocationID.x; light < by_workgroup(push.lights); light += WORKGROUP) {
        most = max(most, log_amplitude(light));
    }
    most = subgroupMax(most);
    if (subgroupElect()) largest[gl_SubgroupID] = most;
    barrier();
    for (uint i = 0u; i < gl_NumSubgroups; i++) most = max(most, largest[i]);
    for (uint light = gl_LocalInvocationID.x; light < by_workgroup(push.lights); light += WORKGROUP) {
        if (!(log_amplitude(light) >= most + push.log_share)) gains[light] = 0.0;
    }
}

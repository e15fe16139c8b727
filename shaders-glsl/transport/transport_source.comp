// Reflectance and direct light of every receiver, and the colors of the lights. An invocation per receiver.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;

#include "transport_source.glsl"

layout(push_constant, scalar) uniform Push {
    uint receivers; // surfels, then patches
    uint surfels;
    uint lights;
} push;

OUT(vec3, reflectance); // [receivers]
OUT(vec3, source);      // [receivers]: radiance
OUT(vec3, colors);      // [lights]

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i < push.lights) colors[i] = exp(log_colors[i]);
    if (i >= push.receivers) return;
    vec3 rho;
    if (i < push.surfels) {
        rho = reflectance_of(materials[i].rgb, materials[i].w, METALLIC ? metallic[i] : 0.0).value;
    } else {
        rho = min(face_albedo(faces[i - push.surfels]) + SHEEN, vec3(1.0));
    }
    vec3 direct = vec3(0.0);
    for (uint light = 0u; light < by_workgroup(push.lights); light++) {
        direct += unit[light * push.receivers + i] * exp(log_colors[light]);
    }
    reflectance[i] = rho;
    source[i] = rho * direct / PI;
}

// Activates the materials of every Gaussian once for all pixels.
#version 460
#include "common.glsl"
#include "material.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const bool METALLIC = false;
layout(local_size_x_id = 0) in;

IN(vec3, albedo);      // raw
IN(float, roughness);  // raw
IN(float, metallic);   // raw, if any
OUT(vec4, values);     // [Gaussians]: albedo, roughness
OUT(float, metallic_values);

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= values.length()) return;
    vec3 a = albedo[i];
    values[i] = vec4(albedo_value(a.x), albedo_value(a.y), albedo_value(a.z), roughness_value(roughness[i]));
    if (METALLIC) metallic_values[i] = sigmoid(metallic[i]);
}

// Source of the adjoint iteration: gradients of radiosity times the reflectance, and of irradiance times pi. See
// transport_begin.glsl.
#version 460
#include "common.glsl"
#include "transport_images.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(constant_id = 1) const bool BY_RADIOSITY = true;
layout(constant_id = 2) const bool BY_IRRADIANCE = true;
layout(local_size_x_id = 0) in;
#include "transport_begin.glsl"

IN(vec3, radiosity_gradient);  // [receivers][lights]
IN(vec3, irradiance_gradient); // [receivers][lights]

vec3 transport_initial(uint receiver, uint light, out vec3 lit) {
    uint at = receiver * push.lights + light;
    lit = vec3(0.0);
    if (BY_RADIOSITY) lit += reflectance_values[receiver] * radiosity_gradient[at];
    if (BY_IRRADIANCE) lit += 3.14159265359 * irradiance_gradient[at];
    return lit;
}

// Gradients of the lights' log colors and of the faces' raw albedo. An invocation per number.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { uint lights; } push;

IN(float, log_colors);          // [lights * 3]
IN(float, by_pixels);           // [lights * 3]: by color, of directly lit pixels
IN(float, by_receivers);        // [(lights + 6) * 3]: by color, then by raw albedo
OUT(float, colors_gradient);    // [lights * 3]: by log color
OUT(float, enclosure_gradient); // [6 * 3]: by raw albedo

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x, colors = 3u * push.lights;
    if (i < colors) {
        colors_gradient[i] = exp(log_colors[i]) * (by_pixels[i] + by_receivers[i]);
    } else if (i < colors + 18u) {
        enclosure_gradient[i - colors] = by_receivers[i];
    }
}

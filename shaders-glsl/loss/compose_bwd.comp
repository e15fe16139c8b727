// Backward of compose: gradients of radiance. Clipped values have none.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool DIRECT = true;
layout(constant_id = 3) const bool AMBIENT = true;

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec3, direct);            // P, linear
IN(vec3, ambient);           // P, linear
IN(float, coverage);         // P
IN(vec3, grad_image);        // P
OUT(vec3, radiance_gradient); // P, the same for direct and ambient

#include "compose.glsl"

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    float covered = coverage[pixel];
    vec3 g = vec3(0.0);
    if (is_covered(covered)) {
        vec3 light;
        vec3 linear = composed(pixel, covered, light);
        g = mix(vec3(0.0), grad_image[pixel], finite3(light));
        g = mix(mix(g, vec3(0.0), srgb_above(linear)), vec3(0.0), srgb_below(linear));
        g *= covered * srgb_slope(linear);
    }
    radiance_gradient[pixel] = g;
}

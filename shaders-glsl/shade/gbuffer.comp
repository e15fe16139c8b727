// G-buffer of a view: a point and a unit normal in the world from blended normals and depth.
//
// Depth is the blended z over the opacity, taken along the ray through the pixel's center.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "splat.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, image);         // [pixels * 5]: normal, z, z²
IN(float, transmittance); // [pixels]
OUT(vec3, points);        // world
OUT(vec3, normals);       // world, unit, or zero
OUT(float, coverage);

void main() {
    Camera camera = params.step.camera;
    uint p = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (p >= camera.size.x * camera.size.y) return;
    float opacity = clamp(1.0 - transmittance[p], 0.0, 1.0);
    float inverse = inverse_coverage(opacity);
    vec3 point = vec3(0.0), normal = vec3(0.0);
    if (inverse > 0.0) {
        float z = image[5u * p + 3u] * inverse;
        vec2 pixel = vec2(p % camera.size.x, p / camera.size.x) + 0.5;
        vec3 seen = vec3((pixel - camera.center) / camera.focal * z, z);
        point = transpose(camera_rotation(camera)) * seen + camera.position;
        vec3 n = vec3(image[5u * p], image[5u * p + 1u], image[5u * p + 2u]);
        // Scaled first: neither tiny nor huge ones leave the range of floats.
        float largest = max(max(abs(n.x), abs(n.y)), abs(n.z));
        if (largest > 0.0 && largest < 1e30) normal = normalize(n / largest);
    }
    points[p] = point;
    normals[p] = normal;
    coverage[p] = opacity;
}

// Environment map as the background of a view: unfiltered, bilinear.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "cube.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint size; // of the cube
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, texels);      // [6 size^2 * 3]
OUT(float, background); // [P * 3]

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    Camera camera = params.step.camera;
    if (i >= camera.size.x * camera.size.y) return;
    vec2 pixel = vec2(i % camera.size.x, i / camera.size.x) + 0.5;
    vec3 ray = vec3((pixel - camera.center) / camera.focal, 1.0);
    vec3 d = ray.x * camera.world_to_camera[0].xyz + ray.y * camera.world_to_camera[1].xyz
           + ray.z * camera.world_to_camera[2].xyz;
    Footprint f = cube_footprint(d, push.size);
    vec3 sum = vec3(0.0);
    [[dont_unroll]] for (uint c = 0u; c < 4u; c++) {
        float w;
        uint at = 3u * corner(f, c, w);
        sum += w * vec3(texels[at], texels[at + 1u], texels[at + 2u]);
    }
    background[3u * i] = sum.x;
    background[3u * i + 1u] = sum.y;
    background[3u * i + 2u] = sum.z;
}

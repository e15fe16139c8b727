// Adds one image to a second and stores a scaled, clamped third; for the tests of images in graphs.
#version 460
#include "common.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(push_constant, scalar) uniform Push { uvec2 size; float scale; } push;

layout(rgba32f) uniform restrict readonly image2D addend;
layout(rgba32f) uniform restrict image2D sum;
layout(rgba8) uniform restrict writeonly image2D displayed;

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(uvec2(at), push.size))) return;
    vec4 texel = imageLoad(sum, at) + imageLoad(addend, at);
    imageStore(sum, at, texel);
    imageStore(displayed, at, texel * push.scale);
}

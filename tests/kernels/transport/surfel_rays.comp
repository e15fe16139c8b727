// Closest and any surfel of each ray, and the patch in which the ray leaves the enclosure.
#version 460
#include "../../../shaders-glsl/include/common.glsl"
#include "../../../shaders-glsl/include/surfels.glsl"
#include "../../../shaders-glsl/include/enclosure.glsl"

layout(local_size_x = 64) in;

layout(push_constant, scalar) uniform Push {
    EnclosureBox enclosure;
    uint count;
} push;

struct Ray {
    vec3 from;
    float reach;
    vec3 along;
    float unused;
};

IN(Ray, rays);
OUT(uint, found); // [rays][3]

void main() {
    uint i = folded_workgroup() * 64u + gl_LocalInvocationID.x;
    if (i >= push.count) return;
    Ray ray = rays[i];
    found[3u * i] = surfel_closest(ray.from, ray.along, ray.reach);
    found[3u * i + 1u] = surfel_hidden(ray.from, ray.along, ray.reach) ? 1u : 0u;
    found[3u * i + 2u] = enclosure_exit(push.enclosure, ray.from, ray.along);
}

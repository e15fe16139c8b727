// Receivers that the cosine-distributed rays of each receiver meet: rows of the transport matrix. An invocation per ray.
//
// Directions are a Hammersley set, shifted for each receiver (Cranley and Patterson 1976) by a hash of its number.
#version 460
#include "common.glsl"
#include "random.glsl"
#include "surfels.glsl"
#include "enclosure.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;

struct Receiver {
    vec3 point;
    float radius; // 0 for a patch
    vec3 normal;
    float unused;
};

layout(push_constant, scalar) uniform Push {
    EnclosureBox enclosure;
    uint receivers;
    uint surfels; // the first ones of the receivers
    uint rays;    // of a receiver
    uint seed;
    float offset; // of rays' begin along the normal
} push;

IN(Receiver, receivers);
OUT(uint, targets); // [receivers][rays]

void main() {
    uint at = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (at >= push.receivers * push.rays) return;
    uint i = at / push.rays, k = at % push.rays;
    Receiver receiver = receivers[i];
    vec3 normal = receiver.normal, from = receiver.point + push.offset * normal;
    // Not finite, or without a normal: no ray.
    if (!(dot(normal, normal) > 0.5 && dot(normal, normal) < 2.0 && dot(from, from) < 1e36)) {
        targets[at] = SURFEL_NONE;
        return;
    }
    // Both coordinates in units of 2^-32, so that they wrap at 1.
    uint stride = 0xffffffffu / push.rays;
    float radial = uniform_from(random_bits(push.seed, i, 0u) + k * stride + stride / 2u);
    float turn = 6.28318530718 * uniform_from(random_bits(push.seed, i, 1u) + bitfieldReverse(k));
    float beside = sqrt(radial);
    vec3 local = vec3(beside * cos(turn), beside * sin(turn), sqrt(1.0 - radial));
    // Orthonormal basis (Duff et al. 2017).
    float side = normal.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (side + normal.z), b = normal.x * normal.y * a;
    vec3 tangent = vec3(1.0 + side * normal.x * normal.x * a, side * b, -side * normal.x);
    vec3 bitangent = vec3(b, side + normal.y * normal.y * a, -normal.y);
    vec3 along = normalize(local.x * tangent + local.y * bitangent + local.z * normal);
    uint met = surfel_closest(from, along, uintBitsToFloat(0x7f7fffffu));
    targets[at] = met != SURFEL_NONE ? met : push.surfels + enclosure_exit(push.enclosure, from, along);
}

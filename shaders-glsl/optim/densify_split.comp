// Densification, step 7: samples the two halves of a split from their parent and makes them smaller.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "splat.glsl"
#include "random.glsl"
#include "densify.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(Work, moves);
IN(Move, entries);
INOUT(vec4, parameters);

const float LOG_SHRINK = 0.47000362924573558; // log 1.6

vec3 normal3(uint parent, uint half_of_it) {
    uint seed = params.densify.seed, k = 4u * half_of_it;
    vec2 a = normal_from(random_bits(seed, parent, k), random_bits(seed, parent, k + 1u));
    vec2 b = normal_from(random_bits(seed, parent, k + 2u), random_bits(seed, parent, k + 3u));
    return vec3(a, b.x);
}

void main() {
    uint t = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (t >= moves[0].count) return;
    Move move = entries[t];
    if (move.kind != SPLIT) return;
    uint home = column_of(move.home, 0u), child = column_of(move.child, 0u);
    uint home_size = column_of(move.home, 1u), child_size = column_of(move.child, 1u);
    vec4 place = parameters[home], size = parameters[home_size];
    vec3 log_scale = size.xyz;
    float unused;
    mat3 axes = quaternion_matrix(unit_quaternion(parameters[column_of(move.home, 2u)], unused));
    vec3 scale = exp(clamp(log_scale, LOG_SCALE_MIN, LOG_SCALE_MAX));
    parameters[home] = vec4(place.xyz + axes * (scale * normal3(move.from, 0u)), place.w);
    parameters[child] = vec4(place.xyz + axes * (scale * normal3(move.from, 1u)), place.w);
    parameters[home_size] = parameters[child_size] = vec4(log_scale - LOG_SHRINK, size.w);
}

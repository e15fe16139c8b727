// Densification, step 7: samples the two halves of a split from their parent and makes them smaller.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "splat.glsl"
#include "random.glsl"
#include "densify.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(Work, moves);
IN(Move, entries);
IN(vec4, rotations);
INOUT(vec3, means);
INOUT(vec3, log_scales);

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
    vec3 mean = means[move.home];
    vec3 log_scale = log_scales[move.home];
    float unused;
    mat3 axes = quaternion_matrix(unit_quaternion(rotations[move.home], unused));
    vec3 scale = exp(clamp(log_scale, LOG_SCALE_MIN, LOG_SCALE_MAX));
    means[move.home] = mean + axes * (scale * normal3(move.from, 0u));
    means[move.child] = mean + axes * (scale * normal3(move.from, 1u));
    log_scales[move.home] = log_scale - LOG_SHRINK;
    log_scales[move.child] = log_scale - LOG_SHRINK;
}

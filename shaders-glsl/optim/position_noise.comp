// Noise on means, after Adam's step (Kheradmand et al. 2024, section 3.2): normal numbers times the covariance, the learning rate of
// means, and a sigmoid of the opacity. Faint Gaussians explore, opaque ones stay.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "splat.glsl"
#include "random.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, live);
IN(uint, flags);
INOUT(vec4, parameters);

const uint RANDOM_NOISE = 0x4e4f4953u;   // apart from other random numbers of the step
const float STEEPNESS = 100.0, MIDDLE = 0.005; // of the sigmoid
const float LEAST_FACTOR = 1e-10; // of the sigmoid: below it a mean moves by less than 1e-8 of its scale

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= live[0].count || flags[0] != 0u) return;
    uint at = column_of(i, 0u);
    vec4 place = parameters[at];
    if (!finite_bits(place.xyz) || !finite_bits(place.w)) return;
    float opacity = 1.0 / (1.0 + exp(-clamp(place.w, -80.0, 80.0)));
    float factor = 1.0 / (1.0 + exp(STEEPNESS * (opacity - MIDDLE)));
    if (factor < LEAST_FACTOR) return;
    vec3 log_scale = parameters[column_of(i, 1u)].xyz;
    if (!finite_bits(log_scale)) return;
    float unused;
    mat3 axes = quaternion_matrix(unit_quaternion(parameters[column_of(i, 2u)], unused));
    vec3 scale = exp(clamp(log_scale, LOG_SCALE_MIN, LOG_SCALE_MAX));
    uint seed = params.step.seed ^ RANDOM_NOISE;
    vec2 a = normal_from(random_bits(seed, i, 0u), random_bits(seed, i, 1u));
    vec2 b = normal_from(random_bits(seed, i, 2u), random_bits(seed, i, 3u));
    vec3 along = transpose(axes) * vec3(a, b.x);
    parameters[at].xyz = place.xyz + axes * (scale * scale * along) * (factor * params.step.noise);
}

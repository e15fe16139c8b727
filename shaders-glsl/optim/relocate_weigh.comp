// Relocation, step 1: which Gaussians are dead, and the weights by which the others are drawn.
//
// A weight is the opacity in units of 1/`scale`, rounded at random, so that it is right in the mean. Sums of weights fit into 32
// bits, and weights stay below 2^19, as prefix sums need.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "adam.glsl"
#include "densify.glsl"
#include "random.glsl"
#include "relocate.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform DensifyBlock { Densify densify; } params;

IN(Work, live);
IN(uvec4, parameters);
OUT(uint, verdicts); // KEEP, or PRUNE for the dead ones
OUT(uint, is_hole);
OUT(uint, weights);
OUT(uint, copies);   // zeros
INOUT(uint, counters);

#include "parameter_columns.glsl"

bool finite(vec3 v) { return is_finite(v.x) && is_finite(v.y) && is_finite(v.z); }

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uint count = live[0].count;
    if (i >= count) return;
    vec4 place = parameter_column(i, 0u), rotation = parameter_column(i, 2u);
    uvec4 pair;
    bool valid = finite(place.xyz) && finite(parameter_column(i, 1u).xyz) && finite(rotation.xyz) &&
                 is_finite(rotation.w) && is_finite(place.w) && finite(harmonic_column(pair, i, 0u).xyz);
    float opacity = 1.0 / (1.0 + exp(-clamp(place.w, -80.0, 80.0)));
    bool dead = !valid || opacity < params.densify.prune_opacity;
    uint scale = min((1u << 19) - 1u, 0xffffffffu / count);
    float random = uniform_from(random_bits(params.densify.seed ^ RANDOM_WEIGHT, i, 0u));
    weights[i] = dead ? 0u : min(uint(opacity * float(scale) + random), scale);
    verdicts[i] = dead ? PRUNE : KEEP;
    is_hole[i] = uint(dead);
    copies[i] = 0u;
    if (!valid) atomicAdd(counters[0], 1u);
}

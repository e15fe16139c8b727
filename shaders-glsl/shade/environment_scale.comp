// Upper bound of any pixel's contribution to a texel's gradient, for sums in fixed point.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "finite.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool METALLIC = false;

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, coverage);
IN(float, materials);
IN(float, metallic);
IN(float, radiance_gradient);
INOUT(uint, largest); // [1] bits of a number that is not negative

#include "environment_bound.glsl"

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    float bound = 0.0;
    if (i < params.step.camera.size.x * params.step.camera.size.y && coverage[i] >= 1e-3) {
        bound = environment_bound(i);
        if (!finite_bits(bound)) bound = 0.0;
    }
    bound = subgroupMax(bound);
    if (subgroupElect() && bound > 0.0) atomicMax(largest[0], floatBitsToUint(bound));
}

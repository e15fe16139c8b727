// Nearest surface point of each light: partial results of workgroups, for lights_regularize.
//
// A workgroup, which is one subgroup, takes a range of blocks. Every lane keeps the nearest of its own pixels for each
// light; lanes are compared once at the end. The lowest pixel wins ties.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;
layout(constant_id = 2) const uint LIGHTS = 64;
layout(constant_id = 3) const uint PER_LANE = 2;

#include "lights.glsl"

layout(push_constant, scalar) uniform Push {
    uint blocks; // of a workgroup
    uint groups; // workgroups that have any
} push;

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec4, prepared);
IN(uint, light_list);
IN(vec3, points);
IN(float, coverage);
OUT(uint, near_partials); // by workgroup and light: distance squared (as bits), pixel

const float FAR = 1e30; // distance of an absent point

float best[LIGHTS];
uint where[LIGHTS];

void main() {
    uint pixels = params.step.camera.size.x * params.step.camera.size.y;
    uint group = folded_workgroup();
    if (group >= push.groups) return;
    uint count = light_list[0];
    [[dont_unroll]] for (uint i = 0u; i < LIGHTS; i++) {
        best[i] = FAR;
        where[i] = 0xffffffffu;
    }
    uint blocks = (pixels + SUBGROUP * PER_LANE - 1u) / (SUBGROUP * PER_LANE);
    uint begin = group * push.blocks, end = min(begin + by_workgroup(push.blocks), blocks);
    for (uint block = begin; block < end; block++) {
        vec3 places[PER_LANE];
        [[unroll]] for (uint p = 0u; p < PER_LANE; p++) {
            uint pixel = min((block * PER_LANE + p) * SUBGROUP + gl_SubgroupInvocationID, pixels - 1u);
            places[p] = is_covered(coverage[pixel]) ? points[pixel] : vec3(1e18);
        }
        for (uint first = 0u; first < count; first += SUBGROUP) {
            uint mine = light_list[1u + min(first + gl_SubgroupInvocationID, count - 1u)];
            vec3 place = prepared[light_at(mine)].xyz;
            for (uint i = 0u; i < min(SUBGROUP, count - first); i++) {
                uint light = subgroupShuffle(mine, i);
                vec3 at = vec3(subgroupShuffle(place.x, i), subgroupShuffle(place.y, i), subgroupShuffle(place.z, i));
                float nearest = best[light];
                uint pixel = where[light];
                [[unroll]] for (uint p = 0u; p < PER_LANE; p++) {
                    vec3 d = at - places[p];
                    float square = dot(d, d);
                    bool nearer = square < nearest;
                    nearest = nearer ? square : nearest;
                    pixel = nearer ? (block * PER_LANE + p) * SUBGROUP + gl_SubgroupInvocationID : pixel;
                }
                best[light] = nearest;
                where[light] = pixel;
            }
        }
    }
    [[dont_unroll]] for (uint light = 0u; light < LIGHTS; light++) {
        float nearest = subgroupMin(best[light]);
        uint pixel = subgroupMin(best[light] == nearest ? where[light] : 0xffffffffu);
        uint at = 2u * (group * LIGHTS + light);
        if (gl_SubgroupInvocationID < 2u) {
            near_partials[at + gl_SubgroupInvocationID] =
                gl_SubgroupInvocationID == 0u ? floatBitsToUint(nearest) : pixel;
        }
    }
}

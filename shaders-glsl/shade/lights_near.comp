// Nearest surface point of each light: partial results of workgroups, for lights_regularize.
//
// A workgroup, which is one subgroup, takes a range of blocks of pixels. A lane keeps the nearest pixels of HELD lights in
// registers, and lanes tell one another their pixels' points. The lowest pixel wins ties, because pixels come in order.
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

const uint BATCHES = (LIGHTS + SUBGROUP - 1u) / SUBGROUP;
const uint HELD = BATCHES < 4u ? BATCHES : 4u; // more lights take another walk over the pixels
#define EACH_HELD(h) [[unroll]] for (uint h = 0u; h < HELD; h++)

shared uint on[(LIGHTS + 31u) / 32u]; // a bit a light

void write_nearest(uint light, float square, uint pixel) {
    uint at = 2u * (folded_workgroup() * LIGHTS + light);
    near_partials[at] = floatBitsToUint(square);
    near_partials[at + 1u] = pixel;
}

void main() {
    uint pixels = params.step.camera.size.x * params.step.camera.size.y;
    uint group = folded_workgroup(), lane = gl_SubgroupInvocationID;
    if (group >= push.groups) return;
    uint count = light_list[0];
    for (uint i = lane; i < on.length(); i += SUBGROUP) on[i] = 0u;
    barrier();
    for (uint i = lane; i < count; i += SUBGROUP) {
        uint light = light_list[1u + i];
        atomicOr(on[light / 32u], 1u << (light % 32u));
    }
    barrier();
    for (uint light = lane; light < LIGHTS; light += SUBGROUP) {
        if ((on[light / 32u] >> (light % 32u) & 1u) == 0u) write_nearest(light, FAR, 0xffffffffu);
    }
    uint blocks = (pixels + SUBGROUP * PER_LANE - 1u) / (SUBGROUP * PER_LANE);
    uint begin = group * push.blocks, end = min(begin + by_workgroup(push.blocks), blocks);
    for (uint first = 0u; first < count; first += HELD * SUBGROUP) {
        uint lights[HELD], nearest[HELD];
        vec3 places[HELD];
        float best[HELD];
        EACH_HELD(h) {
            lights[h] = light_list[1u + min(first + h * SUBGROUP + lane, count - 1u)];
            places[h] = prepared[light_at(lights[h])].xyz;
            best[h] = FAR;
            nearest[h] = 0xffffffffu;
        }
        for (uint row = begin * PER_LANE; row < end * PER_LANE; row++) {
            uint pixel = row * SUBGROUP + lane, inside = min(pixel, pixels - 1u);
            vec3 mine = pixel < pixels && is_covered(coverage[inside]) ? points[inside] : vec3(1e18);
            [[unroll]] for (uint i = 0u; i < SUBGROUP; i++) {
                vec3 point = vec3(subgroupShuffle(mine.x, i), subgroupShuffle(mine.y, i), subgroupShuffle(mine.z, i));
                EACH_HELD(h) {
                    vec3 d = places[h] - point;
                    float square = dot(d, d);
                    bool nearer = square < best[h];
                    best[h] = nearer ? square : best[h];
                    nearest[h] = nearer ? row * SUBGROUP + i : nearest[h];
                }
            }
        }
        EACH_HELD(h) {
            if (first + h * SUBGROUP + lane < count) write_nearest(lights[h], best[h], nearest[h]);
        }
    }
}

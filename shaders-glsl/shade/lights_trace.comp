// Traces the visibility of each active light from a range of pixels: a byte a pair, four neighboring pixels a word.
//
// A workgroup is one subgroup: neighboring pixels and one light, whose rays traverse the tree together.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;

#include "lights.glsl"
#include "traced.glsl"

layout(push_constant, scalar) uniform Push {
    uint first;   // pixel of the stretch
    uint stretch; // pixels from one light's to the next one's, a multiple of SUBGROUP
    float offset;    // of rays' begin above the surface
    float clearance; // of their end before the light
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(vec4, prepared);   // lights, see lights.glsl
IN(uint, light_list); // how many are on, and which
IN(vec3, points);
IN(vec3, normals);
IN(float, coverage);
OUT(uint, seen); // lights x stretch / 4

void main() {
    uint each = push.stretch / SUBGROUP;
    uint group = folded_workgroup(), slot = group / each;
    if (slot >= light_list[0]) return;
    uint lane = gl_SubgroupInvocationID, at = group % each * SUBGROUP + lane, i = push.first + at;
    uint count = params.step.camera.size.x * params.step.camera.size.y, pixel = min(i, count - 1u);
    uint light = light_list[1u + slot];
    vec3 place = prepared[light_at(light)].xyz, point = points[pixel], normal = normals[pixel];
    // A pixel that faces away gets no light, and no kernel reads its visibility.
    bool lit = i < count && is_covered(coverage[pixel]) && dot(normal, place - point) > 0.0;
    vec3 from = point + push.offset * normal, to = place - from;
    float square = dot(to, to), inverse = inversesqrt(max(square, 1e-30));
    float through = traced_transmittance(from, to * inverse, lit ? max(square * inverse - push.clearance, 0.0) : -1.0);
    uint word = (lit ? uint(255.0 * through + 0.5) : 0u) << (8u * (lane & 3u));
    word |= subgroupShuffleXor(word, 1u);
    word |= subgroupShuffleXor(word, 2u);
    if ((lane & 3u) == 0u) seen[(light * push.stretch + at) / 4u] = word;
}

// Converts raw parameters of the lights to the layout that shading reads, and lists active lights. One workgroup.
//
// With PERTURBED, lights are moved, scaled in brightness and some switched off at random: a function of the step's seed,
// the copy and the light.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "random.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;
layout(constant_id = 2) const bool FREE = false;      // axes are free vectors
layout(constant_id = 3) const bool PERTURBED = false;

#include "lights.glsl"

layout(push_constant, scalar) uniform Push {
    uint lights;
    uint copy;       // which of several perturbed copies
    float distance;  // PERTURBED: most that a light moves along each axis
    float off;       // probability that it is off
    float intensity; // most that its intensity changes, as a share
    float missing;   // irradiance, before the normalizer, that may be missing at a pixel because lights were left out
} push;

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec3, positions);
IN(float, lobes);     // LOBES rows a light
IN(float, gains);     // factor of a light's amplitudes; 0 is off
OUT(vec4, prepared);
OUT(uint, light_list);

#include "light_axis.glsl"

const float FAR = 1e38;

// One of the random numbers of a light, between -1 and 1.
float random(uint light, uint which) {
    return 2.0 * uniform_from(random_bits(params.step.seed ^ 0x5a17u, push.copy, 8u * light + which)) - 1.0;
}

float gain(uint light) {
    float g = gains[light];
    if (PERTURBED) {
        g *= 1.0 + push.intensity * random(light, 0u);
        if (0.5 * (random(light, 1u) + 1.0) < push.off) g = 0.0;
    }
    return g;
}

// Distance squared from which on a light's irradiance is less than its share of what may be missing: no direction gets more
// than the sum of the amplitudes.
float reach(uint light) {
    if (!(push.missing > 0.0)) return FAR;
    vec3 sum = vec3(0.0);
    for (uint k = 0u; k < LOBES; k++) sum += lobe_amplitude(load_raw_lobe(light * LOBES + k).amplitude);
    float most = abs(gain(light)) * max(sum.r, max(sum.g, sum.b));
    return min(1.00001 * most * float(push.lights) / push.missing, FAR);
}

void main() {
    uint total = by_workgroup(push.lights) * LOBES;
    for (uint item = gl_LocalInvocationID.x; item < total; item += WORKGROUP) {
        uint light = item / LOBES, lobe = item % LOBES;
        uint at = light_at(light);
        if (lobe == 0u) {
            vec3 place = positions[light];
            if (PERTURBED) place += push.distance * vec3(random(light, 2u), random(light, 3u), random(light, 4u));
            prepared[at] = vec4(place, reach(light));
        }
        RawLobe l = load_raw_lobe(item);
        float root = lobe_root(l.sharpness);
        prepared[at + 1u + 2u * lobe] = vec4(root * lobe_axis(l, lobe), root);
        prepared[at + 2u + 2u * lobe] = vec4(gain(light) * lobe_amplitude(l.amplitude), 0.0);
    }
    if (gl_SubgroupID != 0u) return;
    uint count = 0u;
    for (uint first = 0u; first < by_workgroup(push.lights); first += gl_SubgroupSize) {
        uint light = first + gl_SubgroupInvocationID;
        bool on = light < push.lights && gain(min(light, push.lights - 1u)) != 0.0;
        uvec4 ballot = subgroupBallot(on);
        if (on) light_list[1u + count + subgroupBallotExclusiveBitCount(ballot)] = light;
        count += subgroupBallotBitCount(ballot);
    }
    if (gl_SubgroupInvocationID == 0u) light_list[0] = count;
}

// Backward of lights_prepare: gradients of the lights' raw parameters from sums over pixels, plus those of the
// regularizers. Lights that are off have none.
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;
layout(constant_id = 2) const bool FREE = false;
layout(constant_id = 3) const bool REGULARIZE = false;

#include "lights.glsl"

layout(push_constant, scalar) uniform Push {
    uint lights;
    float weight_near;       // of the mean of 1 / max(d^2, 1e-3)
    float weight_brightness; // of 3 times the mean of the amplitudes
} push;

IN(float, lobes);
IN(float, gains);
IN(vec4, prepared);
IN(float, light_gradients); // lights x 8 (1 + LOBES), see lights_bwd.glsl
IN(uint, nearest);          // see lights_regularize.comp
IN(vec3, points);
OUT(vec3, positions_gradient);
OUT(float, lobes_gradient);

#include "light_axis.glsl"

void main() {
    uint item = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (item >= push.lights * LOBES) return;
    uint light = item / LOBES, lobe = item % LOBES;
    uint row = light * 8u * (1u + LOBES), at = row + 8u + 8u * lobe;
    RawLobe raw = load_raw_lobe(item);
    bool on = gains[light] != 0.0;
    float root = lobe_root(raw.sharpness);
    vec3 axis = NATURAL * root * vec3(light_gradients[at], light_gradients[at + 1u], light_gradients[at + 2u]);
    float sharpness = raw.sharpness <= SHARPNESS_MAX ? -0.5 * NATURAL * light_gradients[at + 3u] : 0.0;
    vec3 amplitude = prepared[light_at(light) + 2u + 2u * lobe].rgb
                   * vec3(light_gradients[at + 4u], light_gradients[at + 5u], light_gradients[at + 6u]);
    if (REGULARIZE && on) {
        amplitude += push.weight_brightness / float(push.lights * LOBES) * lobe_amplitude(raw.amplitude);
    }
    amplitude *= vec3(lessThanEqual(raw.amplitude, vec3(AMPLITUDE_MAX)));
    axis = by_raw_axis(raw, lobe, axis);
    uint i = item * LOBE_FLOATS;
    lobes_gradient[i] = axis.x;
    lobes_gradient[i + 1u] = axis.y;
    if (FREE) lobes_gradient[i + 2u] = axis.z;
    i += FREE ? 3u : 2u;
    lobes_gradient[i] = sharpness;
    lobes_gradient[i + 1u] = amplitude.r;
    lobes_gradient[i + 2u] = amplitude.g;
    lobes_gradient[i + 3u] = amplitude.b;
    if (lobe == 0u) {
        vec3 g = vec3(light_gradients[row], light_gradients[row + 1u], light_gradients[row + 2u]);
        if (REGULARIZE && on && nearest[2u * light + 1u] != 0xffffffffu) {
            float square = uintBitsToFloat(nearest[2u * light]);
            vec3 d = prepared[light_at(light)].xyz - points[nearest[2u * light + 1u]];
            if (square > NEAR_SQUARED) g -= 2.0 * push.weight_near / float(push.lights) / (square * square) * d;
        }
        positions_gradient[light] = g;
    }
}

// Level 0 of the multi-scale gradient loss: materials minus their priors, where both are present.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "msg.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool ROUGHNESS = true; // whether roughness and its prior exist
layout(constant_id = 3) const bool MASKED = false;   // whether to compare only pixels of a mask
layout(constant_id = 4) const bool ALL_VIEWS = true; // whether the prior buffers hold all views or only this view

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec3, albedo_srgb);      // P
IN(vec3, roughness_gray);   // P, only the first channel is read
IN(uint, albedo_prior);     // packed RGBA8; alpha 0 marks a missing prior
IN(uint, roughness_prior);  // likewise, in red
IN(float, coverage);        // P
IN(uint, mask);             // one bit per pixel, from word mask_offset
OUT(vec4, levels);          // albedo and roughness minus the priors; 0 without a comparison
OUT(uint, present);         // HAS_ALBEDO, HAS_ROUGHNESS

// Smallest coverage of a compared pixel. Below it, too much of the pixel is background.
const float OPAQUE = 0.5;

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    bool counts = coverage[pixel] >= OPAQUE;
    if (MASKED) counts = counts && (mask[params.step.mask_offset + pixel / 32u] >> (pixel % 32u) & 1u) != 0u;
    uint at = pixel + (ALL_VIEWS ? params.step.target_offset : 0u);
    uint prior = albedo_prior[at], bits = 0u;
    vec4 d = vec4(0.0);
    if (counts && prior >> 24 != 0u) {
        d.rgb = albedo_srgb[pixel] - unpackUnorm4x8(prior).rgb;
        bits = HAS_ALBEDO;
    }
    if (ROUGHNESS) {
        prior = roughness_prior[at];
        if (counts && prior >> 24 != 0u) {
            d.w = roughness_gray[pixel].x - unpackUnorm4x8(prior).r;
            bits |= HAS_ROUGHNESS;
        }
    }
    levels[pixel] = d;
    present[pixel] = bits;
}

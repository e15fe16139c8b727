// Packs the Gaussians' features as halves, two a word, for blending in this step.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "half.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint FEATURES = 32;
layout(local_size_x_id = 0) in;

IN(Work, gaussians);
IN(float, raw_features);    // [Gaussians * FEATURES]
OUT(uint, packed_features); // [Gaussians * FEATURES / 2]

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i / (FEATURES / 2u) >= gaussians[0].count) return;
    packed_features[i] = pack_halves(vec2(raw_features[2u * i], raw_features[2u * i + 1u]));
}

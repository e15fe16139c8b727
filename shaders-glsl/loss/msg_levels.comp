// Coarser levels of the multi-scale gradient loss.
//
// A tent filter, as wide as two pixels of the level, filters differences and masks. A pixel of a level is valid if
// almost all image pixels below it are.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "msg.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;

INOUT(vec4, levels);  // the first level is read, the others are written
INOUT(uint, present); // likewise

// Smallest share of valid pixels. A few pixels can have a share of exactly 0.999 (a hole of 1/40 by 1/25), and rounding
// would decide about it. No few pixels have this share.
const float ALMOST = 0.99903;

void main() {
    uvec2 size = params.step.camera.size;
    uint pixels = size.x * size.y, there;
    uint element = pixels + folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    uint level = level_of(size, element, there);
    if (level >= LEVELS) return;
    uint across = level_size(size, level).x;
    vec2 scale = level_scale(size, level);
    Tent tx = tent_of(there % across, scale.x, size.x), ty = tent_of(there / across, scale.y, size.y);
    vec4 sum = vec4(0.0);
    vec3 shares = vec3(0.0); // weights of pixels with albedo, with roughness, and of all
    for (int y = ty.first; y < ty.end; y++) {
        float wy = tent_weight(ty, y);
        for (int x = tx.first; x < tx.end; x++) {
            float w = wy * tent_weight(tx, x);
            uint pixel = uint(y) * size.x + uint(x), bits = present[pixel];
            sum += w * levels[pixel];
            shares += w * vec3(float(bits & HAS_ALBEDO), float((bits & HAS_ROUGHNESS) >> 1), 1.0);
        }
    }
    levels[element] = sum / shares.z;
    bvec2 whole = greaterThanEqual(shares.xy, vec2(ALMOST * shares.z));
    present[element] = (whole.x ? HAS_ALBEDO : 0u) | (whole.y ? HAS_ROUGHNESS : 0u);
}

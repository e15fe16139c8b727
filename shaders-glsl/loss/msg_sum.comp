// Sums the levels of the multi-scale gradient loss in a fixed order. One workgroup.
//
// Writes the losses, and the factors of the slopes of each level.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "msg.glsl"
#include "material_weights.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILE_X = 28; // tile size of msg_slopes
layout(constant_id = 3) const uint TILE_Y = 16;
layout(constant_id = 4) const bool SQUARE = false; // whether the loss includes squared differences
layout(constant_id = 5) const bool OWN = false;    // own prior instead of an estimate under other light

#define SUM_T vec4
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    float share; // share of the weight: 1 / number of estimates
} push;

layout(scalar) uniform StepBlock { Step step; } params;
layout(scalar) uniform WeightsBlock { MaterialWeights weights; } loss_weights;

IN(vec4, sums);
OUT(MsgLevels, result);

void main() {
    uvec2 size = params.step.camera.size;
    MaterialWeights w = loss_weights.weights;
    vec2 weights = push.share * (SQUARE ? vec2(OWN ? w.own_prior : w.relight, 0.0) : vec2(w.albedo_msg, w.roughness_msg));
    vec2 losses = vec2(0.0);
    vec2 square = vec2(0.0);
    uint first = 0u;
    MsgLevels r;
    [[unroll]] for (uint level = 0u; level < LEVELS; level++) {
        uvec2 tiles = level_tiles(size, level, uvec2(TILE_X, TILE_Y));
        uint end = first + tiles.x * tiles.y;
        vec4 sum = vec4(0.0);
        for (uint i = first + gl_LocalInvocationID.x; i < end; i += WORKGROUP) sum += sums[i];
        barrier(); // before the shared sums are written again
        sum = group_sum(sum);
        if (SQUARE) {
            square += sum.zw;
            sum.zw = vec2(0.0);
        }
        // Levels without valid pixels contribute nothing.
        vec2 inverse = vec2(sum.y > 0.0 ? 1.0 / sum.y : 0.0, sum.w > 0.0 ? 1.0 / sum.w : 0.0) / float(LEVELS);
        losses += inverse * sum.xz;
        r.factors[level] = weights * inverse * vec2(1.0 / 3.0, 1.0);
        first = end;
    }
    if (gl_LocalInvocationID.x != 0u) return;
    float inverse = square.y > 0.0 ? 1.0 / square.y : 0.0;
    r.square_factor = weights.x * inverse;
    r.albedo = losses.x;
    r.roughness = losses.y;
    r.square = square.x * inverse;
    r.pixels = square.y;
    result[0] = r;
}

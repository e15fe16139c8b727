// Backward of the multi-scale gradient loss: gathers the slopes of all levels at every pixel of the image.
//
// The transposed tent filter is bilinear interpolation between pixels of a level.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "msg.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool ROUGHNESS = true;
layout(constant_id = 3) const bool SQUARE = false; // whether the loss includes squared differences

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec4, levels);
IN(uint, present);
IN(vec4, slopes);
IN(MsgLevels, result);
INOUT(vec3, albedo_gradient);    // P, added to
INOUT(vec3, roughness_gradient); // P, added to the first channel

// Returns the weights of the two pixels of a level next to an image pixel. `first`, the index of the first, may be -1.
vec2 halves(uint at, float scale, out int first) {
    float place = (float(at) + 0.5) / scale - 0.5;
    float before = floor(place);
    first = int(before);
    return vec2(1.0 - (place - before), place - before);
}

void main() {
    uvec2 size = params.step.camera.size;
    uint pixel = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (pixel >= size.x * size.y) return;
    uint bits = present[pixel];
    if (bits == 0u) return;
    uvec2 at = uvec2(pixel % size.x, pixel / size.x);
    vec4 g = result[0].factors[0].xxxy * slopes[pixel];
    if (SQUARE) g.rgb += 2.0 * result[0].square_factor * levels[pixel].rgb;
    uint base = size.x * size.y;
    [[unroll]] for (uint level = 1u; level < LEVELS; level++) {
        uvec2 there = level_size(size, level);
        vec2 scale = level_scale(size, level);
        ivec2 first;
        vec2 wx = halves(at.x, scale.x, first.x), wy = halves(at.y, scale.y, first.y);
        vec4 sum = vec4(0.0);
        [[unroll]] for (int j = 0; j < 2; j++) {
            [[unroll]] for (int i = 0; i < 2; i++) {
                uvec2 q = uvec2(first + ivec2(i, j)); // -1 wraps around and fails the comparison
                if (q.x < there.x && q.y < there.y) sum += wx[i] * wy[j] * slopes[base + q.y * there.x + q.x];
            }
        }
        g += result[0].factors[level].xxxy * sum;
        base += there.x * there.y;
    }
    if ((bits & HAS_ALBEDO) != 0u) albedo_gradient[pixel] += g.rgb;
    if (ROUGHNESS && (bits & HAS_ROUGHNESS) != 0u) roughness_gradient[pixel].x += g.w;
}

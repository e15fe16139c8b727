// Packs one layer of a blended view into texels of an image format, and reports overflow to the host.
//
// Colors are display-referred (sRGB-encoded) and stay so unless LINEAR requests linear light; an image whose format
// decodes sRGB gets the encoded values unchanged. Shaded images are linear and are encoded here. Depth and normals are the
// blended values, not divided by alpha.
#version 460
#include "common.glsl"
#include "step.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint CHANNELS = 3;
layout(constant_id = 2) const uint LAYER = 0;  // 0 color, 1 depth, 2 normal, 3 alpha
layout(constant_id = 3) const uint FIRST = 0;  // channel where the layer begins
layout(constant_id = 4) const uint TEXEL = 0;  // 0 RGBA8, 1 BGRA8, 2 RGBA16 float, 3 RGBA32 float
layout(constant_id = 5) const uint LINEAR = 0; // 1: colors are decoded to linear light; 2: they are, and get encoded
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push { float depth_scale; } push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(float, image);         // [pixels * CHANNELS]
IN(float, transmittance); // [pixels]
IN(uint, flags);          // [1] not zero if the entries did not fit
IN(uint, required);         // [1] entries that the frame requires
OUT(uint, texels);        // [pixels * words of a texel]
INOUT(uint, report);      // [3] frames; frames that did not fit; most entries that a frame required

float linear(float v) { return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4); }

float encoded(float v) { return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1.0 / 2.4) - 0.055; }

// NaN becomes 0.
uint byte(float v) { return v > 0.0 ? uint(min(v, 1.0) * 255.0 + 0.5) : 0u; }

uint bytes(vec4 v) { return byte(v.x) | byte(v.y) << 8 | byte(v.z) << 16 | byte(v.w) << 24; }

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i == 0u) {
        report[0] = report[0] + 1u;
        report[1] = report[1] + (flags[0] != 0u ? 1u : 0u);
        report[2] = max(report[2], required[0]);
    }
    uvec2 size = params.step.camera.size;
    if (i >= size.x * size.y) return;
    float alpha = 1.0 - transmittance[i];
    vec3 v = vec3(alpha);
    if (LAYER == 0u || LAYER == 2u) {
        v = vec3(image[i * CHANNELS + FIRST], image[i * CHANNELS + FIRST + 1u], image[i * CHANNELS + FIRST + 2u]);
        if (LINEAR == 1u) v = vec3(linear(v.x), linear(v.y), linear(v.z));
        if (LINEAR == 2u) v = vec3(encoded(v.x), encoded(v.y), encoded(v.z));
        if (LAYER == 2u && TEXEL < 2u) v = v * 0.5 + 0.5;
    } else if (LAYER == 1u) {
        v = vec3(image[i * CHANNELS + FIRST] * push.depth_scale);
    }
    if (TEXEL == 0u) {
        texels[i] = bytes(vec4(v, alpha));
    } else if (TEXEL == 1u) {
        texels[i] = bytes(vec4(v.zyx, alpha));
    } else if (TEXEL == 2u) {
        // The largest half, so that rounding cannot make infinities.
        vec3 h = clamp(v, vec3(-65504.0), vec3(65504.0));
        texels[2u * i] = packHalf2x16(h.xy);
        texels[2u * i + 1u] = packHalf2x16(vec2(h.z, alpha));
    } else {
        texels[4u * i] = floatBitsToUint(v.x);
        texels[4u * i + 1u] = floatBitsToUint(v.y);
        texels[4u * i + 2u] = floatBitsToUint(v.z);
        texels[4u * i + 3u] = floatBitsToUint(alpha);
    }
}

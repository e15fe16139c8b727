// The semantic loss of the training view, one invocation a sample of its target map: blended features are sampled where
// the sample lies, decoded in their small form, compared with the target and classified.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint WORKGROUP = 128;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CLASSES = 1;
layout(constant_id = 3) const uint CHANNELS = 35; // floats of a pixel of the image
layout(constant_id = 4) const uint FIRST = 3;     // channel of the first feature

#define SUM_T vec3
#include "group_sum.glsl"

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(SemanticTarget, targets); // of all views
IN(float, gram);
IN(float, text);
INOUT(float, products);      // samples x 33: the target through the decoder; afterwards s f'
OUT(float, grad_features);   // samples x 32
INOUT(float, partials);
OUT(vec3, sums);             // by workgroup: 1 - cos, cross-entropy, samples that did not count

#include "semantic_chunk.glsl"

void fetch(uint i, out float f[AUGMENTED]) {
    uvec2 size = params.step.camera.size, map = params.step.semantic_size;
    vec2 wx, wy;
    uint x = aligned(i % map.x, map.x, size.x, wx), y = aligned(i / map.x, map.y, size.y, wy);
    uint right = min(x + 1u, size.x - 1u), below = min(y + 1u, size.y - 1u);
    uint p00 = (y * size.x + x) * CHANNELS + FIRST, p10 = (y * size.x + right) * CHANNELS + FIRST;
    uint p01 = (below * size.x + x) * CHANNELS + FIRST, p11 = (below * size.x + right) * CHANNELS + FIRST;
    // A neighbor without weight must not be asked: it may not be finite.
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
        float v = wx.x * wy.x * image[p00 + k];
        if (wx.y > 0.0) v += wx.y * wy.x * image[p10 + k];
        if (wy.y > 0.0) v += wx.x * wy.y * image[p01 + k];
        if (wx.y * wy.y > 0.0) v += wx.y * wy.y * image[p11 + k];
        f[k] = v;
    }
    f[FEATURES] = 1.0;
}

void main() {
    Step s = params.step;
    uint count = s.semantic_size.x * s.semantic_size.y;
    vec3 sum = vec3(0.0);
    for (uint first = gl_WorkGroupID.x * WORKGROUP; first < count; first += gl_NumWorkGroups.x * WORKGROUP) {
        uint i = first + gl_LocalInvocationID.x;
        SemanticTarget target = SemanticTarget(0.0, NO_LABEL);
        float f[AUGMENTED], u[AUGMENTED], a[FEATURES];
        float inverse = 0.0;
        [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) f[k] = u[k] = 0.0;
        [[unroll]] for (uint k = 0u; k < FEATURES; k++) a[k] = 0.0;
        bool live = false;
        if (i < count) {
            target = targets[s.semantic_offset + i];
            live = target.inverse_norm > 0.0;
            if (live) {
                fetch(i, f);
                live = decode(f, u, inverse);
            }
            if (!live) sum.z += 1.0;
        }
        float along = 0.0, own = 0.0; // s, and what the cosine adds to k
        if (live) {
            float product = 0.0;
            [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) product = fma(products[i * AUGMENTED + k], f[k], product);
            float cosine = product * inverse * target.inverse_norm;
            sum.x += 1.0 - cosine;
            float weight = s.weight_semantic / float(max(s.semantic_valid, 1u));
            along = -weight * target.inverse_norm * inverse;
            own = weight * cosine * inverse * inverse;
            [[unroll]] for (uint k = 0u; k < FEATURES; k++) a[k] = along * products[i * AUGMENTED + k];
        }
        float weight = s.weight_semantic_class / float(max(s.semantic_labeled, 1u));
        sum.y += add_chunk(live, f, u, inverse, weight, target.label, own, a);
        if (i < count) {
            [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) products[i * AUGMENTED + k] = live ? along * f[k] : 0.0;
            [[unroll]] for (uint k = 0u; k < FEATURES; k++) grad_features[i * FEATURES + k] = a[k] * f[FEATURES];
        }
    }
    vec3 total = group_sum(sum);
    if (gl_LocalInvocationID.x == 0u) sums[gl_WorkGroupID.x] = total;
}

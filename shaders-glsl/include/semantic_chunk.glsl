// The part that semantic_samples and correspondence_bwd share: the gradient of a workgroup's samples by their features,
// and what they add to the sums that the decoder's gradient is made of. With v = A f', n = |v|, the loss's derivative is
//     by v:  s t + sum_c e_c T_c + k v
//     by f:  s (W^T t) + sum_c e_c (T W)_c + k (A^T A f')
//     by A:  sum s t f'^T  +  T^T (sum e f'^T)  +  A (sum k f' f'^T)
// and the two sums in parentheses are what is added here, by workgroup.
//
// Needs WORKGROUP, CLASSES and the buffer `partials`, zero at first: (AUGMENTED + CLASSES) x AUGMENTED by workgroup.
#include "semantic_decode.glsl"

const uint BLOCK = 8u;               // classes at a time
const uint THREES = AUGMENTED / 3u;
const uint ROWS = AUGMENTED + CLASSES;

shared float staged_f[WORKGROUP * AUGMENTED]; // odd pitch: no bank conflicts
shared float staged_e[WORKGROUP * BLOCK];
shared uint busy;

// Adds `count` rows of sums over the workgroup's samples. `square`: rows k f_row; else rows of e.
void add_rows(uint first, uint count, bool square) {
    for (uint item = gl_LocalInvocationID.x; item < count * THREES; item += WORKGROUP) {
        uint row = item / THREES, at = item % THREES * 3u;
        vec3 sum = vec3(0.0);
        for (uint i = 0u; i < WORKGROUP; i++) {
            uint f = i * AUGMENTED;
            float e = square ? staged_e[i] * staged_f[f + row] : staged_e[row * WORKGROUP + i];
            sum += e * vec3(staged_f[f + at], staged_f[f + at + 1u], staged_f[f + at + 2u]);
        }
        uint to = (gl_WorkGroupID.x * ROWS + first + row) * AUGMENTED + at;
        partials[to] += sum.x;
        partials[to + 1u] += sum.y;
        partials[to + 2u] += sum.z;
    }
}

// One sample a invocation, all of a workgroup together. `live`: it counts; its decoded `f`, `u`, `inverse` follow.
// `weight`: of the cross-entropy to `label`, zero without one. `own`: what k has already. Adds to `a`, the gradient by f
// before the division by what f was divided by; returns the cross-entropy.
float add_chunk(bool live, float f[AUGMENTED], float u[AUGMENTED], float inverse, float weight, uint label, float own,
                inout float a[FEATURES]) {
    uint lane = gl_LocalInvocationID.x;
    if (lane == 0u) busy = 0u;
    barrier();
    if (live) busy = 1u;
    bool labeled = live && label < CLASSES;
    float scale = inverse * params.step.inverse_temperature;
    Softmax s = Softmax(0.0, 1.0, 0.0);
    if (labeled) s = softmax_of(f, scale, label);
    [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) staged_f[lane * AUGMENTED + k] = live ? f[k] : 0.0;
    barrier();
    if (busy == 0u) return 0.0;
    float along = 0.0;
    for (uint first = 0u; first < CLASSES; first += BLOCK) {
        uint count = min(BLOCK, CLASSES - first);
        for (uint q = 0u; q < count; q++) {
            float e = 0.0;
            if (labeled) {
                uint c = first + q;
                float logit = class_product(c, f) * scale;
                float g = weight * (exp(logit - s.top) / s.total - float(c == label));
                along = fma(g, logit, along);
                e = g * scale;
                [[unroll]] for (uint k = 0u; k < FEATURES; k++) a[k] = fma(e, text[c * AUGMENTED + k], a[k]);
            }
            staged_e[q * WORKGROUP + lane] = e;
        }
        barrier();
        add_rows(AUGMENTED + first, count, false);
        barrier();
    }
    float k_all = live ? own - along * inverse * inverse : 0.0;
    staged_e[lane] = k_all;
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) a[k] = fma(k_all, u[k], a[k]);
    barrier();
    add_rows(0u, AUGMENTED, true);
    barrier();
    return labeled ? log(s.total) + s.top - s.chosen : 0.0;
}

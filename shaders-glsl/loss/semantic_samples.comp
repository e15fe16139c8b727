// Semantic loss of the training view, in batches of samples of its target map.
//
// Blended features are interpolated at the positions of the samples, decoded by the small matrices, compared with the
// targets, and classified.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILES = 1;
layout(constant_id = 3) const uint CLASSES = 1;
layout(constant_id = 4) const uint CHANNELS = 35; // floats of a pixel of the image
layout(constant_id = 5) const uint FIRST = 3;     // channel of the first feature
layout(constant_id = 6) const uint PARTS = 1;     // partial sums of each product

layout(push_constant, scalar) uniform Push { uint largest; } push; // samples between the products of two parts

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(SemanticTarget, targets); // of all views
IN(float, matrices);
INOUT(float, products);      // PARTS x largest rows: targets projected by the decoder; the first part then becomes s f'
OUT(float, grad_features);   // samples x 32
OUT(float, partials);
OUT(vec3, sums);             // by workgroup: 1 - cos, cross-entropy, excluded samples

#define STAGES_IN_SHARED
#include "semantic_sums.glsl"

// Laid out like `staged`. Each use has its own array, since compile time grows with the square of an array's uses; in shared
// memory one use follows another.
float staged_products[TILES * SPREAD], staged_rows[TILES * SPREAD], staged_gradients[TILES * SPREAD];

// Interpolates features at the samples of a batch into `staged`.
void fetch(uint from, uint count) {
    uvec2 size = params.step.camera.size, map = params.step.semantic_size;
    SHORT for (uint t = 0u; t < TILES; t++) {
        uint i = min(from + t * SUBGROUP + gl_SubgroupInvocationID, count - 1u);
        vec2 wx, wy;
        uint x = aligned(i % map.x, map.x, size.x, wx), y = aligned(i / map.x, map.y, size.y, wy);
        uint pixel = y * size.x + x;
        SHORT for (uint n = 0u; n < ACROSS; n++) {
            uint lane = lane_of(n);
            vec2 across = subgroupShuffle(wx, lane), down = subgroupShuffle(wy, lane);
            // A neighbor without weight must not be read, since it may be non-finite or out of bounds.
            uint right = across.y > 0.0 ? CHANNELS : 0u, below = down.y > 0.0 ? size.x * CHANNELS : 0u;
            uint at = subgroupShuffle(pixel, lane) * CHANNELS + FIRST + column();
            SHORT for (uint h = 0u; h < HELD; h++) {
                float v = across.x * down.x * image[at];
                v += right > 0u ? across.y * down.x * image[at + right] : 0.0;
                v += below > 0u ? across.x * down.y * image[at + below] : 0.0;
                v += right > 0u && below > 0u ? across.y * down.y * image[at + right + below] : 0.0;
                STAGE(staged, t * SPREAD + n * HELD + h, v)
                at += ACROSS;
            }
        }
    }
}

// Fetches the products of targets and decoder into `staged_products`.
void fetch_products(uint from, uint count) {
    SHORT for (uint t = 0u; t < TILES; t++) {
        SHORT for (uint n = 0u; n < ACROSS; n++) {
            uint at = min(from + t * SUBGROUP + lane_of(n), count - 1u) * PITCH + column();
            SHORT for (uint h = 0u; h < HELD; h++) {
                float x = 0.0;
                for (uint p = 0u; p < PARTS; p++) x += products[p * push.largest * PITCH + at + h * ACROSS];
                STAGE(staged_products, t * SPREAD + n * HELD + h, x)
            }
        }
    }
}

// Writes a staged array by sample.
#define WRITE_STAGED(buffer_, pitch, array_)                                                                          \
    SHORT for (uint t_ = 0u; t_ < TILES; t_++) {                                                               \
        SHORT for (uint n_ = 0u; n_ < ACROSS; n_++) {                                                          \
            uint i_ = from + t_ * SUBGROUP + lane_of(n_);                                                      \
            if (i_ < count) {                                                                                  \
                SHORT for (uint h_ = 0u; h_ < HELD; h_++)                                                      \
                    buffer_[i_ * pitch + h_ * ACROSS + column()] = STAGED(array_, t_ * SPREAD + n_ * HELD + h_); \
            }                                                                                                  \
        }                                                                                                      \
    }

void main() {
    uint count = params.step.semantic_size.x * params.step.semantic_size.y;
    float weight = params.step.weight_semantic / float(max(params.step.semantic_valid, 1u));
    float class_weight = params.step.weight_semantic_class / float(max(params.step.semantic_labeled, 1u));
    vec3 sum = vec3(0.0);
    keep_rows();
    clear_sums();
    for (uint from = gl_WorkGroupID.x * BATCH; from < count; from += gl_NumWorkGroups.x * BATCH) {
        float inverse_target[TILES], product_bias[TILES];
        EACH_TILE(t) {
            uint i = from + t * SUBGROUP + gl_SubgroupInvocationID, at = min(i, count - 1u);
            SemanticTarget target = targets[params.step.semantic_offset + at];
            inverse_target[t] = target.inverse_norm;
            label[t] = target.label;
            live[t] = i < count && target.inverse_norm > 0.0;
            product_bias[t] = 0.0;
            for (uint p = 0u; p < PARTS; p++) product_bias[t] += products[(p * push.largest + at) * PITCH + FEATURES];
        }
        fetch(from, count);
        bring();
        measure();
        fetch_products(from, count);
        EACH_TILE(t) {
            [[unroll]] for (uint k = 0u; k < SPREAD; k++) a[t * SPREAD + k] = STAGED(staged_products, t * SPREAD + k);
        }
        float along[TILES]; // s
        EACH_TILE(t) {
            DOT_ITEMS(product, a[AT_(t)], f[AT_(t)], t)
            product = fma(product_bias[t], bias[t], product);
            float cosine = product * inverse[t] * inverse_target[t];
            along[t] = live[t] ? -weight * inverse_target[t] * inverse[t] : 0.0;
            own[t] = weight * cosine * inverse[t] * inverse[t];
            bool counted = from + t * SUBGROUP + gl_SubgroupInvocationID < count;
            sum.x += live[t] ? 1.0 - cosine : 0.0;
            sum.z += counted && !live[t] ? 1.0 : 0.0;
            EACH_ITEM(n) {
                float s = subgroupShuffle(along[t], lane_of(n));
                EACH_HELD(h) {
                    uint k = t * SPREAD + n * HELD + h;
                    // Products of excluded samples, whose s is zero, may be non-finite. Compilers may assume that numbers are finite,
                    // and leave out a comparison of floats.
                    a[k] = (floatBitsToUint(s) & 0x7fffffffu) != 0u ? s * a[k] : 0.0;
                }
            }
        }
        sum.y += descend(class_weight);
        EACH_TILE(t) {
            EACH_ITEM(n) {
                float s = subgroupShuffle(along[t], lane_of(n));
                EACH_HELD(h) STAGE(staged_rows, t * SPREAD + n * HELD + h, s * f[t * SPREAD + n * HELD + h])
            }
            uint i = from + t * SUBGROUP + gl_SubgroupInvocationID;
            if (i < count) products[i * PITCH + FEATURES] = along[t] * bias[t];
        }
        WRITE_STAGED(products, PITCH, staged_rows)
        EACH_TILE(t) EACH_ITEM(n) {
            float by = subgroupShuffle(bias[t], lane_of(n));
            EACH_HELD(h) STAGE(staged_gradients, t * SPREAD + n * HELD + h, by * a[t * SPREAD + n * HELD + h])
        }
        WRITE_STAGED(grad_features, FEATURES, staged_gradients)
    }
    write_sums();
    sum = subgroupAdd(sum);
    if (subgroupElect()) sums[gl_WorkGroupID.x] = sum;
}

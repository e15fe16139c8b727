// Shared definitions of the semantic kernels.
//
// Features f are decoded to a wide vector by a linear map, v = W f + b = A f', with A = [W b] and f' = (f, 1). The wide
// vector is never formed: |v|^2 = f'^T (A^T A) f', and a class's dot product is (T A) f'.

#include "finite.glsl"

const uint FEATURES = 32u;
const uint AUGMENTED = FEATURES + 1u; // with the one that the bias is multiplied by
const uint EMBEDDING = 512u;          // width of targets, text and decoder
const uint EMBEDDING_WORDS = EMBEDDING / 2u;
const uint PITCH = 36u;               // of rows of 33 in buffers that only kernels see
const uint NO_LABEL = 0xffffffffu;

// One sample of the targets, worked out once.
struct SemanticTarget {
    float inverse_norm; // 0 where the target is invalid
    uint label;         // NO_LABEL where there is none
};

// A region of one image.
struct Region {
    float mean[32]; // of the features, over the region's pixels
    float count;    // of these pixels
    uint majority;  // class of most of them
    uint unused[30]; // each region of a buffer can be bound on its own
};

const float LEAST_PIXELS = 16.0; // smaller regions are no evidence

// Where sample `i` of `samples` along an axis lies between `pixels` ones if the first and last of both coincide. In whole
// numbers, so that scattering and gathering kernels agree: pixel, and weights of it and the next.
uint aligned(uint i, uint samples, uint pixels, out vec2 weights) {
    uint steps = max(samples, 2u) - 1u;
    uint at = samples > 1u ? i * (pixels - 1u) : 0u;
    uint rest = at % steps;
    weights = vec2(float(steps - rest), float(rest)) / float(steps);
    return at / steps;
}

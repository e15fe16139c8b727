// Lengths and classes of decoded features. Needs the buffers `gram` (A^T A) and `text` (T A), and CLASSES.

// Below this share of its parts' size a decoded vector is rounding noise: it has length and direction of nothing.
const float NOTHING = 1e-6; // squared

// Brings features to at most one (what is asked of them depends on their direction alone, and huge ones would
// overflow), adds the bias's factor, and gives gram * f and 1 / length. False if a feature is not finite.
bool decode(inout float f[AUGMENTED], out float u[AUGMENTED], out float inverse) {
    float largest = 1.0;
    bool finite = true;
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
        finite = finite && finite_bits(f[k]);
        largest = max(largest, abs(f[k]));
    }
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) f[k] = finite ? f[k] / largest : 0.0;
    f[FEATURES] = finite ? 1.0 / largest : 0.0;
    float square = 0.0, cross = 0.0;
    [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) {
        float sum = 0.0;
        for (uint l = 0u; l < AUGMENTED; l++) sum = fma(gram[k * AUGMENTED + l], f[l], sum);
        u[k] = sum;
        square = fma(f[k], sum, square);
    }
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) cross = fma(gram[FEATURES * AUGMENTED + k], f[k], cross);
    cross *= f[FEATURES];
    float least = max(1e-16 * f[FEATURES] * f[FEATURES], NOTHING * (square - 2.0 * cross));
    inverse = square > least ? 1.0 / sqrt(square) : 0.0;
    return finite;
}

// The dot product of a class's text with the decoded vector, before any division.
float class_product(uint c, float f[AUGMENTED]) {
    float sum = 0.0;
    [[unroll]] for (uint k = 0u; k < AUGMENTED; k++) sum = fma(text[c * AUGMENTED + k], f[k], sum);
    return sum;
}

// What the softmax over all classes needs: largest logit, sum of exponentials below it, the logit of `label`.
struct Softmax {
    float top;
    float total;
    float chosen;
};

Softmax softmax_of(float f[AUGMENTED], float scale, uint label) {
    Softmax s = Softmax(-1e30, 0.0, 0.0);
    for (uint c = 0u; c < CLASSES; c++) {
        float logit = class_product(c, f) * scale;
        if (c == label) s.chosen = logit;
        float top = max(s.top, logit);
        s.total = s.total * exp(s.top - top) + exp(logit - top);
        s.top = top;
    }
    return s;
}

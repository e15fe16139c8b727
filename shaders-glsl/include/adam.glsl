// One Adam step of one scalar (Kingma and Ba 2015; beta 0.9 and 0.999, epsilon 1e-15 as in 3D Gaussian splatting).

// One minus the betas, written out: 1 - 0.999 in 32 bits is off by 5e-5.
const float ADAM_RATE1 = 0.1;
const float ADAM_RATE2 = 0.001;
const float ADAM_EPSILON = 1e-15;
// Gradients are clamped here, where the square and its bias correction still fit: an overflowing second moment would
// hold its parameter still for thousands of steps.
const float ADAM_LARGEST = 1e15;

// By the exponent's bits: compilers may assume that isnan() and isinf() are never true.
bool is_finite(float x) { return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u; }

// By the bits: a device that flushes denormals finds them equal to zero.
bool is_zero(float x) { return (floatBitsToUint(x) & 0x7fffffffu) == 0u; }

// `moments`: first and second; `correction1`, `correction2`: 1 / (1 - beta^t). A gradient that is not finite changes
// nothing; counting those is the caller's.
void adam(inout float parameter, inout vec2 moments, float gradient, float lr, float correction1, float correction2,
          float epsilon) {
    if (!is_finite(gradient)) return;
    gradient = clamp(gradient, -ADAM_LARGEST, ADAM_LARGEST);
    moments.x += ADAM_RATE1 * (gradient - moments.x);
    moments.y += ADAM_RATE2 * (gradient * gradient - moments.y);
    parameter -= lr * (moments.x * correction1) / (sqrt(moments.y * correction2) + epsilon);
}

void adam(inout float parameter, inout vec2 moments, float gradient, float lr, float correction1, float correction2) {
    adam(parameter, moments, gradient, lr, correction1, correction2, ADAM_EPSILON);
}

// Shared definitions of the relocation kernels: the plan, and what several Gaussians in the place of one look like.

struct RelocatePlan {
    uint before; // Gaussians before
    uint dead;   // of them, those that move
    uint draws;  // Gaussians to draw: one for each dead one, then one for each new one
    uint total;  // sum of all weights
};

// Random numbers of relocation, apart from each other.
const uint RANDOM_WEIGHT = 0x52454c4fu;
const uint RANDOM_DRAW = 0x43415445u;

// -log(1 - y), for y in [0, 1). The series keeps small numbers exact, which 1 - y would round.
float minus_log_one_minus(float y) {
    return y < 0.05 ? y * (1.0 + y * (1.0 / 2.0 + y * (1.0 / 3.0 + y * (1.0 / 4.0 + y * (1.0 / 5.0 + y / 6.0)))))
                    : -log(1.0 - y);
}

// 1 - exp(-z), for z >= 0.
float one_minus_exp(float z) {
    return z < 0.05 ? z * (1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0)))) : 1.0 - exp(-z);
}

// 2 / sqrt(pi) times the integral of 1 - (1 - o exp(-x²))^n from 0 to infinity: the opacity of `n` Gaussians of opacity `o`, one behind the
// other, along a line through their centers. The binomial sum of Kheradmand et al. 2024, equation 9, is this integral term by
// term, but its terms cancel. The trapezoidal rule converges exponentially.
const uint NODES = 48u;
const float NODE_STEP = 0.125;
float opacity_along_line(float o, float n) {
    float sum = 0.5 * one_minus_exp(n * minus_log_one_minus(o));
    for (uint k = 1u; k < NODES; ++k) {
        float x = NODE_STEP * float(k);
        sum += one_minus_exp(n * minus_log_one_minus(o * exp(-x * x)));
    }
    return 1.1283791670955126 * NODE_STEP * sum; // 2 / sqrt(pi)
}

// What each of `n` Gaussians must have in the place of one: the logit of its opacity, and the logarithm of the factor on its
// scales. Their opacities together are the one's, at the center and along a line.
vec2 relocated(float logit, float n, float least_opacity) {
    logit = clamp(logit, -80.0, 80.0);
    // -log(1 - opacity), without 1 - opacity, which would round to 0.
    float e = exp(-abs(logit));
    float depth = max(logit, 0.0) + minus_log_one_minus(e / (1.0 + e));
    float part = depth / n;
    float opacity = min(one_minus_exp(part), 0.99999994);
    float shrink = log(one_minus_exp(depth)) - log(opacity_along_line(opacity, n));
    float least = log(least_opacity) - log(1.0 - least_opacity);
    return vec2(max(log(opacity) + part, least), shrink);
}

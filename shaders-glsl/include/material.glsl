// Materials of a Gaussian are kept before their activation: albedo and roughness lie in (0.09, 0.99), metallic in (0, 1).
const float MATERIAL_LOW = 0.09;
const float MATERIAL_RANGE = 0.9;

float sigmoid(float x) { return 1.0 / (1.0 + exp(-clamp(x, -80.0, 80.0))); }

float material_value(float raw) { return MATERIAL_LOW + MATERIAL_RANGE * sigmoid(raw); }

// d(value)/d(raw), from raw: without the cancellation of 1 - sigmoid where it is saturated.
float sigmoid_slope(float raw) { return sigmoid(raw) * sigmoid(-raw); }

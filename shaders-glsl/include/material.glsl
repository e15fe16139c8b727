// Activation of materials: albedo in (0.01, 0.99), roughness in (0.09, 0.99), metallic in (0, 1).
//
// Gaussians store materials before activation. The published range of albedo begins at 0.09, which displays as a third of
// white; black objects are darker. Training may use another range of albedo; files use this one.
layout(constant_id = 26) const float ALBEDO_LOW = 0.01;
layout(constant_id = 27) const float ALBEDO_RANGE = 0.98;
const float ROUGHNESS_LOW = 0.09;
const float ROUGHNESS_RANGE = 0.9;

float sigmoid(float x) { return 1.0 / (1.0 + exp(-clamp(x, -80.0, 80.0))); }

float albedo_value(float raw) { return ALBEDO_LOW + ALBEDO_RANGE * sigmoid(raw); }

float roughness_value(float raw) { return ROUGHNESS_LOW + ROUGHNESS_RANGE * sigmoid(raw); }

// d(value)/d(raw), from raw: without the cancellation of 1 - sigmoid where it is saturated.
float sigmoid_slope(float raw) { return sigmoid(raw) * sigmoid(-raw); }

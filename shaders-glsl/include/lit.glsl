// Per-frame parameters of a shaded view, besides the camera and the lights.

struct LitStep {
    vec3 behind;      // background behind shaded light, linear
    float exposure;   // factor of all light
    vec3 environment; // factors of the environment map's light
};

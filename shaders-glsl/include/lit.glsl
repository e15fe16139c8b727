// What changes from frame to frame of a shaded view, besides the camera and the lights.

struct LitStep {
    vec3 behind;      // what lies behind light, linear
    float exposure;   // factor of all light
    vec3 environment; // factors of the light of the surroundings
};

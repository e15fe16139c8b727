// Light of a pixel over the background, for `compose` and its backward. Needs `direct`, `ambient`, `coverage`, the
// constants DIRECT and AMBIENT, and `params`.
#include "coverage.glsl"
#include "finite.glsl"
#include "srgb.glsl"

// What is composed, and the light's part of it.
vec3 composed(uint pixel, float covered, out vec3 light) {
    light = vec3(0.0);
    if (is_covered(covered)) {
        if (DIRECT) light += direct[pixel];
        if (AMBIENT) light += ambient[pixel];
        light *= covered;
    }
    return only_finite(light) + (1.0 - covered) * srgb_decode(params.step.background);
}

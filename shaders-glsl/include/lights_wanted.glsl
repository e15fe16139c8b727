// What the loss wants of a pixel's light: the gradient of its radiance, times its material. Needs lights_pixels.glsl and a
// buffer `radiance_gradient`.

// A pixel's material times the gradient of its radiance.
struct Wanted {
    vec3 gradient;
    vec3 matte; // gradient times the Lambert term
    vec3 f0;
    float f90;
};

vec3 fresnel_of(Wanted w, float c) { return METALLIC ? mix(w.f0, vec3(w.f90), c) : vec3(0.04 + 0.96 * c); }

Wanted load_wanted(uint pixel, bool is_shaded, float normalizer) {
    Wanted w = Wanted(vec3(0.0), vec3(0.0), vec3(0.04), 1.0);
    if (is_shaded) {
        w.gradient = normalizer * radiance_gradient[pixel];
        vec3 albedo = materials[pixel].rgb;
        float metal = 0.0;
        if (METALLIC) {
            metal = metallic[pixel];
            w.f0 = fresnel0(albedo, metal);
            w.f90 = fresnel90(w.f0);
        }
        w.matte = (1.0 - metal) / PI * albedo * w.gradient;
    }
    return w;
}

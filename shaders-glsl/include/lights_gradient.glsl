// Gradient of a pixel's radiance times its material, for backward kernels of lights. Needs lights_pixels.glsl and a
// buffer `radiance_gradient`.

// A pixel's material times the gradient of its radiance.
struct PixelGradient {
    vec3 gradient;
    vec3 matte; // gradient times the Lambert term
    vec3 f0;
    float f90;
};

vec3 fresnel_of(PixelGradient w, float c) { return METALLIC ? mix(w.f0, vec3(w.f90), c) : vec3(0.04 + 0.96 * c); }

PixelGradient load_pixel_gradient(uint pixel, bool is_shaded, float normalizer) {
    PixelGradient w = PixelGradient(vec3(0.0), vec3(0.0), vec3(0.04), 1.0);
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

// sRGB encoding (IEC 61966-2-1), clipped at black and white, its slope, and its inverse.

bvec3 finite3(vec3 v) { return bvec3(finite_bits(v.x), finite_bits(v.y), finite_bits(v.z)); }

// A number that is not one counts as black.
vec3 only_finite(vec3 v) { return mix(vec3(0.0), v, finite3(v)); }

vec3 srgb_encode(vec3 linear) {
    vec3 v = clamp(linear, 0.0, 1.0);
    return mix(12.92 * v, 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, greaterThan(v, vec3(0.0031308)));
}

// Derivative of the encoding of clipped values: that at black or white, not zero.
vec3 srgb_slope(vec3 linear) {
    vec3 v = clamp(linear, 0.0031308, 1.0);
    return mix(vec3(12.92), (1.055 / 2.4) * pow(v, vec3(1.0 / 2.4 - 1.0)), greaterThan(linear, vec3(0.0031308)));
}

bvec3 srgb_above(vec3 linear) { return greaterThan(linear, vec3(1.0)); }
bvec3 srgb_below(vec3 linear) { return lessThan(linear, vec3(0.0)); }

vec3 srgb_decode(vec3 encoded) {
    vec3 v = clamp(encoded, 0.0, 1.0);
    return mix(v / 12.92, pow((v + 0.055) / 1.055, vec3(2.4)), greaterThan(v, vec3(0.04045)));
}

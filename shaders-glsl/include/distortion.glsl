// Radial distortion of cameras: a pixel offset m from the principal point becomes m (1 + radial q), where q is the square of |m|
// over half the diagonal of the image. Included after step.glsl.

// Whether cameras may have it. A branch by `radial` itself would be one by uniforms alone: see by_workgroup().
layout(constant_id = 39) const bool DISTORTED = false;

// 1 / (half the diagonal)².
float distortion_unit(Camera c) { return 4.0 / dot(vec2(c.size), vec2(c.size)); }

// a and b, with which the derivative of a distorted offset by m is a I + b m mᵀ. The distorted offset is a m.
vec2 distortion_terms(Camera c, vec2 m) {
    float scaled = c.radial * distortion_unit(c);
    return vec2(1.0 + scaled * dot(m, m), 2.0 * scaled);
}

// x/z and y/z of the points that a pixel shows.
vec2 pixel_slope(Camera c, vec2 pixel) {
    vec2 offset = pixel - c.center;
    if (!DISTORTED) return offset / c.focal;
    // Newton's method for the factor that removes the distortion. It is near one.
    float x = c.radial * distortion_unit(c) * dot(offset, offset), t = 1.0;
    [[unroll]] for (uint i = 0u; i < 4u; ++i) t -= (t * (1.0 + x * t * t) - 1.0) / max(1.0 + 3.0 * x * t * t, 0.1);
    return t * offset / c.focal;
}

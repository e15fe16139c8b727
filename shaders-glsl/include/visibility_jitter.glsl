// Jitter of points and lights for the field's smoothness loss: one draw a pixel and one a light, the same for all pairs.
// Needs random.glsl and visibility_grid.glsl.

const uint POINTS = 0x51a7u, LIGHTS = 0xb0c3u;

vec3 jitter_of(FieldStep field, uint kind, uint index) {
    uint seed = field.seed ^ kind;
    vec2 a = normal_from(random_bits(seed, index, 0u), random_bits(seed, index, 1u));
    vec2 b = normal_from(random_bits(seed, index, 2u), random_bits(seed, index, 3u));
    return field.jitter * vec3(a, b.x);
}

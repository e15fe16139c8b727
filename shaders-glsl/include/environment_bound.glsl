// Upper bound of a pixel's contribution to a texel's gradient. Not finite where the pixel's gradient or material is not:
// such a pixel contributes nothing. Needs METALLIC, `materials`, `metallic` and `radiance_gradient`.
float environment_bound(uint i) {
    vec3 g = abs(vec3(radiance_gradient[3u * i], radiance_gradient[3u * i + 1u], radiance_gradient[3u * i + 2u]));
    vec3 a = abs(vec3(materials[4u * i], materials[4u * i + 1u], materials[4u * i + 2u]));
    float metal = METALLIC ? abs(metallic[i]) : 0.0;
    // F0 a + b with a, b <= 1, and (1 - M) A. Added rather than compared, so that non-finite values propagate.
    float most = 1.04 + abs(materials[4u * i + 3u]) + (1.0 + metal) * (a.x + a.y + a.z + 1.0);
    return (g.x + g.y + g.z) * most;
}

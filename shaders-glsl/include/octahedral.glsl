// Unit vector in 32 bits: the octahedron's faces unfolded onto a square, 16 bits each way (Meyer et al. 2010). The
// pattern 0 means no vector; encoders never produce it.

bool octahedral_present(uint packed) { return packed != 0u; }

vec3 octahedral_decode(uint packed) {
    vec2 e = 2.0 * unpackUnorm2x16(packed) - 1.0;
    vec3 n = vec3(e, 1.0 - abs(e.x) - abs(e.y));
    float fold = max(-n.z, 0.0);
    n.x += n.x >= 0.0 ? -fold : fold;
    n.y += n.y >= 0.0 ? -fold : fold;
    return normalize(n);
}

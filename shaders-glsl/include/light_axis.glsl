// Raw parameters of a lobe and their activation. Needs constants LOBES and FREE, and a buffer `lobes`.
//
// In the grid's layout a row is polar angle, azimuth, log sharpness, log amplitude of red, green, blue: 6 floats. The
// angles are squashed by tanh around the centers of a grid of one or two rows. With FREE axes a row is axis (3), log
// sharpness, log amplitudes: 7 floats, and the axis is normalized on use.

const float SHARPNESS_MAX = 9.5;  // of log sharpness
const float AMPLITUDE_MAX = 15.0; // of log amplitudes
const float AXIS_MIN = 1e-6;      // shorter free axes count as pointing to +z
const float QUARTER = 0.785398163397;

const uint LOBE_FLOATS = FREE ? 7u : 6u;

struct RawLobe {
    vec3 axis;       // angles and 0, or a vector
    float sharpness; // logs
    vec3 amplitude;
};

RawLobe load_raw_lobe(uint item) {
    uint i = item * LOBE_FLOATS;
    RawLobe l;
    l.axis = vec3(lobes[i], lobes[i + 1u], 0.0);
    if (FREE) l.axis.z = lobes[i + 2u];
    i += FREE ? 3u : 2u;
    l.sharpness = lobes[i];
    l.amplitude = vec3(lobes[i + 1u], lobes[i + 2u], lobes[i + 3u]);
    return l;
}

// tanh and its derivative, which 1 - tanh^2 would lose far out.
vec2 squash(float x) {
    float e = exp(-2.0 * abs(x));
    float d = 1.0 / (1.0 + e);
    return vec2(sign(x) * (1.0 - e) * d, 4.0 * e * d * d);
}

// Polar angle and azimuth, and their derivatives by the raw ones.
vec4 lobe_angles(vec3 raw, uint lobe) {
    uint rows = LOBES % 2u == 0u ? 2u : 1u, columns = LOBES / rows;
    float polar = (float(lobe / columns) + 0.5) * (2.0 * QUARTER / float(rows));
    float azimuth = ((float(lobe % columns) + 0.5) / float(columns) - 0.5) * (8.0 * QUARTER);
    vec2 p = 1.5 * QUARTER * squash(raw.x), a = 2.0 * QUARTER * squash(raw.y);
    return vec4(polar + p.x, azimuth + a.x, p.y, a.y);
}

vec3 lobe_axis(RawLobe l, uint lobe) {
    if (FREE) {
        float size = length(l.axis);
        return size > AXIS_MIN ? l.axis / size : vec3(0.0, 0.0, 1.0);
    }
    vec4 angles = lobe_angles(l.axis, lobe);
    return vec3(sin(angles.x) * vec2(cos(angles.y), sin(angles.y)), cos(angles.x));
}

// sqrt(lambda log2(e) / 2).
float lobe_root(float raw) { return 0.849321800288 * exp(0.5 * min(raw, SHARPNESS_MAX)); }

vec3 lobe_amplitude(vec3 raw) { return exp(min(raw, vec3(AMPLITUDE_MAX))); }

// Gradient of the raw axis from that of the unit one.
vec3 by_raw_axis(RawLobe l, uint lobe, vec3 g) {
    if (FREE) {
        float size = length(l.axis);
        vec3 b = l.axis / max(size, AXIS_MIN);
        return size > AXIS_MIN ? (g - b * dot(b, g)) / size : vec3(0.0);
    }
    vec4 angles = lobe_angles(l.axis, lobe);
    float sin_p = sin(angles.x), cos_p = cos(angles.x), sin_a = sin(angles.y), cos_a = cos(angles.y);
    float by_polar = cos_p * (cos_a * g.x + sin_a * g.y) - sin_p * g.z;
    float by_azimuth = sin_p * (cos_a * g.y - sin_a * g.x);
    return vec3(by_polar * angles.z, by_azimuth * angles.w, 0.0);
}

// Angles and logarithms with a relative error of a few units in the last place. The built-in functions may be off by 4096.

// atan(y, x), in [-pi, pi]; 0 for two zeros. Polynomial: Cephes, atanf.
float angle_of(float y, float x) {
    float a = abs(y), b = abs(x);
    float t = min(a, b) / max(max(a, b), 1e-37);
    bool upper = t > 0.41421356;
    float r = upper ? (t - 1.0) / (t + 1.0) : t;
    float z = r * r;
    r += ((((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1) * z) * r;
    if (upper) r += 0.785398163397;
    if (a > b) r = 1.57079632679 - r;
    if (x < 0.0) r = 3.14159265359 - r;
    return y < 0.0 ? -r : r;
}

// atan(z) / z.
float atan_ratio(float z) { return abs(z) < 1e-3 ? 1.0 - z * z * (1.0 / 3.0) : angle_of(z, 1.0) / z; }

// log(1 + z) / z, for z > -1.
float log_ratio(float z) {
    float h = z / (2.0 + z), s = h * h;
    if (abs(h) < 0.2) return (2.0 / (2.0 + z)) * (1.0 + s * (1.0 / 3.0 + s * (0.2 + s * (1.0 / 7.0))));
    return log(1.0 + z) / z;
}

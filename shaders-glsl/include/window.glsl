// The window of SSIM: 11 taps of a normalized Gaussian of sigma 1.5 (Wang et al. 2004; the widths of 3D Gaussian
// splatting), as a filter with memory. Samples go in one by one along a row or column; the weighted mean over the last
// eleven comes out. Each sample is loaded once for all eleven outputs that it belongs to, and nothing is indexed, so
// the ten partial sums stay in registers on every device.
// window_tap is the other form, for single outputs: the filter takes ten samples before its first one.
// Define WINDOW_T (float, vec3, ...) before including this file.

const uint WINDOW_RADIUS = 5u;
const uint WINDOW_DELAY = 10u; // outputs are complete from this sample on, counted from 0

const uint WINDOW_TAPS = 11u;

// The weight of a sample of the window. Callers pass constants.
float window_tap(uint i) {
    const float taps[WINDOW_TAPS] = float[WINDOW_TAPS](0.00102838012, 0.00759875821, 0.0360007733, 0.109360687, 0.213005543,
                                                       0.266011715, 0.213005543, 0.109360687, 0.0360007733, 0.00759875821,
                                                       0.00102838012);
    return taps[i];
}

// Partial sums of the ten outputs that are under way, the next one first.
struct Window {
    WINDOW_T a0, a1, a2, a3, a4, a5, a6, a7, a8, a9;
};

Window window_start() {
    WINDOW_T z = WINDOW_T(0.0);
    return Window(z, z, z, z, z, z, z, z, z, z);
}

// Takes the next sample; returns the window's mean around the sample WINDOW_RADIUS steps before.
WINDOW_T window_next(inout Window w, WINDOW_T s) {
    const float g0 = 0.00102838012, g1 = 0.00759875821, g2 = 0.0360007733;
    const float g3 = 0.109360687, g4 = 0.213005543, g5 = 0.266011715;
    WINDOW_T mean = fma(WINDOW_T(g0), s, w.a0);
    w.a0 = fma(WINDOW_T(g1), s, w.a1);
    w.a1 = fma(WINDOW_T(g2), s, w.a2);
    w.a2 = fma(WINDOW_T(g3), s, w.a3);
    w.a3 = fma(WINDOW_T(g4), s, w.a4);
    w.a4 = fma(WINDOW_T(g5), s, w.a5);
    w.a5 = fma(WINDOW_T(g4), s, w.a6);
    w.a6 = fma(WINDOW_T(g3), s, w.a7);
    w.a7 = fma(WINDOW_T(g2), s, w.a8);
    w.a8 = fma(WINDOW_T(g1), s, w.a9);
    w.a9 = WINDOW_T(g0) * s;
    return mean;
}

// Distance between the mean features of two regions.

// The distance; 0, and `direction` with it, where there is none or it is not a number. `counts`: whether this pair does.
float region_distance(Region a, Region b, out float direction[FEATURES], out bool counts) {
    float largest = 0.0;
    bool finite = true;
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
        direction[k] = a.mean[k] - b.mean[k];
        finite = finite && finite_bits(direction[k]);
        largest = max(largest, abs(direction[k]));
    }
    counts = finite && a.count >= LEAST_PIXELS && b.count >= LEAST_PIXELS;
    float square = 0.0;
    bool apart = counts && largest > 0.0;
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) {
        direction[k] = apart ? direction[k] / largest : 0.0;
        square = fma(direction[k], direction[k], square);
    }
    float size = sqrt(square);
    [[unroll]] for (uint k = 0u; k < FEATURES; k++) direction[k] = apart ? direction[k] / size : 0.0;
    return apart ? largest * size : 0.0;
}

// Derivative filters of 3 x 3 taps over a tile in shared memory, and their transposes.
//
// Both directions are a difference of neighbors across a weighted sum of three, (SIDE, MIDDLE, SIDE), times SCALE. Values
// lie in `tile_data` with two pixels of margin. The loss's derivatives by the filtered values lie in `tile_x` and `tile_y`
// with one pixel of margin, zero beyond the image; the transposed filters of these are the gradient. A caller that marches
// down a column reads each row once.
//
// Needs constants TILE_X, TILE_Y, SIDE, MIDDLE, SCALE, and REFLECT: whether pixels beyond the border mirror those inside
// (the border itself is not repeated) or repeat the last one.

const uint DATA_X = TILE_X + 4u, DATA_Y = TILE_Y + 4u;
const uint SLOPE_X = TILE_X + 2u, SLOPE_Y = TILE_Y + 2u;

shared vec4 tile_data[DATA_X * DATA_Y];
shared vec4 tile_x[SLOPE_X * SLOPE_Y];
shared vec4 tile_y[SLOPE_X * SLOPE_Y];

// The pixel that stands at a place of a row or column of so many.
int tile_inside(int at, int last) {
    if (REFLECT) at = at < 0 ? -at : (at > last ? 2 * last - at : at);
    return clamp(at, 0, last);
}

// What a row gives to the filters of the rows around it.
struct TileRow {
    vec4 difference, smoothed;
};

TileRow tile_row(uint at) {
    vec4 a = tile_data[at], b = tile_data[at + 1u], c = tile_data[at + 2u];
    return TileRow(c - a, SIDE * (a + c) + MIDDLE * b);
}

vec4 tile_along_x(TileRow above, TileRow here, TileRow below) {
    return SCALE * (SIDE * (above.difference + below.difference) + MIDDLE * here.difference);
}

vec4 tile_along_y(TileRow above, TileRow below) { return SCALE * (below.smoothed - above.smoothed); }

// Transposed taps at a place: from the one before it, from itself, from the one after it.
struct TileTaps {
    vec3 difference, smoothed;
};

TileTaps tile_taps(int at, int last) {
    float low = float(at == 0), high = float(at == last);
    if (!REFLECT) return TileTaps(vec3(1.0, high - low, -1.0), vec3(SIDE, MIDDLE + SIDE * (low + high), SIDE));
    // The first one also sees the second where its left neighbor would be.
    float second = float(at == 1), last_but_one = float(at == last - 1);
    vec3 smoothed = vec3(SIDE + SIDE * second, MIDDLE + 2.0 * SIDE * low * high, SIDE + SIDE * last_but_one);
    return TileTaps(vec3(1.0 - second, 0.0, last_but_one - 1.0), smoothed);
}

// The same for the transposed filters: contributions of a row of slopes to the rows around it.
TileRow tile_transposed_row(uint at, TileTaps x) {
    vec4 d = x.difference.x * tile_x[at] + x.difference.y * tile_x[at + 1u] + x.difference.z * tile_x[at + 2u];
    vec4 s = x.smoothed.x * tile_y[at] + x.smoothed.y * tile_y[at + 1u] + x.smoothed.z * tile_y[at + 2u];
    return TileRow(d, s);
}

vec4 tile_transposed(TileRow above, TileRow here, TileRow below, TileTaps y) {
    vec4 x = y.smoothed.x * above.difference + y.smoothed.y * here.difference + y.smoothed.z * below.difference;
    vec4 s = y.difference.x * above.smoothed + y.difference.y * here.smoothed + y.difference.z * below.smoothed;
    return SCALE * (x + s);
}

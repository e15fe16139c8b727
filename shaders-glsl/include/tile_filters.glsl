// Derivative filters of 3 x 3 taps over a tile in shared memory, and their transposes.
//
// Both directions are a difference of neighbors across a weighted sum of three, (SIDE, MIDDLE, SIDE), times SCALE. Values,
// and a word each, have two pixels of margin. The loss's derivatives by the filtered values, called slopes, have one pixel of
// margin and are zero beyond the image. The transposed filters of the slopes are the gradient. A caller that marches
// down a column reads each row once.
//
// Needs constants WORKGROUP, TILE_X, TILE_Y, SIDE, MIDDLE, SCALE, and
//     RUN      rows of one invocation
//     REUSE    whether slopes take the place of the values. An invocation then has one run at most, and keeps its slopes in
//              registers until all have read the values: WORKGROUP is at least the number of runs. It halves shared memory.
//     TILE_XYZ, TILE_W  which components slopes have; without reuse the others are not stored
//     REFLECT  whether pixels beyond the border mirror those inside (the border itself is not repeated) or repeat the last one

const uint DATA_X = TILE_X + 4u, DATA_Y = TILE_Y + 4u;
const uint SLOPE_X = TILE_X + 2u, SLOPE_Y = TILE_Y + 2u;
const uint TILE_DATA = DATA_X * DATA_Y, TILE_SLOPES = SLOPE_X * SLOPE_Y;
const uint TILE_VALUES = TILE_DATA + (REUSE ? (TILE_DATA + 3u) / 4u : 0u); // vectors of values, and of their words
const uint SLOPE_AT = REUSE ? 0u : TILE_VALUES;
const uint SLOPE_END = SLOPE_AT + 2u * TILE_SLOPES;
const uint SLOPE_RUNS = SLOPE_X * ((SLOPE_Y + RUN - 1u) / RUN);

// Values, words, slopes along x and along y. Words keep all bits of any of them. Without reuse, words are an array of their
// own: CPUs address one faster.
shared uint tile_words[REUSE ? 1u : TILE_DATA];
shared uvec4 tile_pool[SLOPE_END > TILE_VALUES ? SLOPE_END : TILE_VALUES];

void set_tile_data(uint at, vec4 value, uint word) {
    tile_pool[at] = floatBitsToUint(value);
    if (REUSE) tile_pool[TILE_DATA + at / 4u][at % 4u] = word;
    else tile_words[at] = word;
}

vec4 tile_data(uint at) { return uintBitsToFloat(tile_pool[at]); }
uint tile_word(uint at) { return REUSE ? tile_pool[TILE_DATA + at / 4u][at % 4u] : tile_words[at]; }
vec4 tile_x(uint at) { return uintBitsToFloat(tile_pool[SLOPE_AT + at]); }
vec4 tile_y(uint at) { return uintBitsToFloat(tile_pool[SLOPE_AT + TILE_SLOPES + at]); }
float tile_x_w(uint at) { return uintBitsToFloat(tile_pool[SLOPE_AT + at].w); }
float tile_y_w(uint at) { return uintBitsToFloat(tile_pool[SLOPE_AT + TILE_SLOPES + at].w); }

void set_tile_slopes(uint at, vec4 x, vec4 y) {
    uint to_x = SLOPE_AT + at, to_y = to_x + TILE_SLOPES;
    if (REUSE || (TILE_XYZ && TILE_W)) {
        tile_pool[to_x] = floatBitsToUint(x);
        tile_pool[to_y] = floatBitsToUint(y);
    } else if (TILE_W) {
        tile_pool[to_x].w = floatBitsToUint(x.w);
        tile_pool[to_y].w = floatBitsToUint(y.w);
    } else {
        tile_pool[to_x].xyz = floatBitsToUint(x.xyz);
        tile_pool[to_y].xyz = floatBitsToUint(y.xyz);
    }
}

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
    vec4 a = tile_data(at), b = tile_data(at + 1u), c = tile_data(at + 2u);
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
    vec4 d = x.difference.x * tile_x(at) + x.difference.y * tile_x(at + 1u) + x.difference.z * tile_x(at + 2u);
    vec4 s = x.smoothed.x * tile_y(at) + x.smoothed.y * tile_y(at + 1u) + x.smoothed.z * tile_y(at + 2u);
    return TileRow(d, s);
}

vec4 tile_transposed(TileRow above, TileRow here, TileRow below, TileTaps y) {
    vec4 x = y.smoothed.x * above.difference + y.smoothed.y * here.difference + y.smoothed.z * below.difference;
    vec4 s = y.difference.x * above.smoothed + y.difference.y * here.smoothed + y.difference.z * below.smoothed;
    return SCALE * (x + s);
}

// Photometric loss, first half: SSIM of every pixel and channel, its three partial derivatives, and the sums.
//
// One workgroup processes one tile. The first pass filters columns and reads each sample once, directly from the image.
// Neighboring invocations read neighboring pixels. The windowed means of (x, y, x^2 + y^2, xy) go to shared memory. The
// second pass filters rows of these means and again reads each sample once for all outputs of a run. One barrier
// separates the passes. With RUN 1, both passes add up taps instead, and each mean is read eleven times. Values are shifted by one half so that variances cancel less. Pixels outside the image are zero
// before the shift, as in the published definition.
#version 460
#include "common.glsl"
#include "step.glsl"
#define WINDOW_T vec4
#include "window.glsl"

layout(constant_id = 0) const uint WORKGROUP = 96;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILE_X = 22;   // columns of a tile; 32 with both margins
layout(constant_id = 3) const uint TILE_Y = 16;
layout(constant_id = 4) const uint RUN = 11;      // outputs of one invocation along a row; divides TILE_X; 1: taps add up
layout(constant_id = 5) const uint CHANNELS = 3;  // floats of a pixel of the image
layout(constant_id = 6) const uint AHEAD = 2;     // rows that are loaded together; divides TILE_Y + WINDOW_DELAY

#define SUM_T vec2
#include "group_sum.glsl"

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);    // P x CHANNELS, the first three are red, green, blue
IN(uint, targets);   // packed RGBA8; alpha 0 masks the pixel
OUT(vec3, partials); // 3 x P: derivatives of SSIM by mean, by variance, by covariance, for each channel
OUT(vec2, sums);     // by workgroup: of |x - y|, of SSIM

const float C1 = 1e-4;
const float C2 = 9e-4;
const uint COLUMNS = TILE_X + 2u * WINDOW_RADIUS;
const uint PITCH = COLUMNS | 1u; // odd, so that runs of neighboring rows start in different banks

shared vec4 means[3u * TILE_Y * PITCH];

vec2 fetch(uint pixel, uint channel) {
    uint packed = targets[params.step.target_offset + pixel];
    float y = float(bitfieldExtract(packed, int(8u * channel), 8)) / 255.0;
    // A masked pixel takes the value of its photograph, so that its difference is zero.
    return vec2(packed >> 24 == 0u ? y : image[pixel * CHANNELS + channel], y);
}

// Several loads are unconditional, so that they can be issued together.
vec2 fetch_or_zero(uvec2 size, uint x, uint y, uint channel) {
    if (AHEAD == 1u && (x >= size.x || y >= size.y)) return vec2(0.0);
    vec2 v = fetch(min(y, size.y - 1u) * size.x + min(x, size.x - 1u), channel);
    return x < size.x && y < size.y ? v : vec2(0.0);
}

// Returns SSIM from the windowed means of shifted values, and its derivatives by the means of x, x^2 and xy.
float ssim(vec4 m, out vec3 derivatives) {
    vec2 mu = m.xy + 0.5;
    float a1 = 2.0 * mu.x * mu.y + C1;
    float b1 = dot(mu, mu) + C1;
    // For values far above one, variances and covariance are mostly rounding errors. Clamp them to their valid ranges:
    // variances to at least zero, the covariance to at most half of their sum. Otherwise, SSIM and its gradients are
    // unbounded.
    float variances = max(m.z - dot(m.xy, m.xy), 0.0);
    float a2 = 2.0 * clamp(m.w - m.x * m.y, -0.5 * variances, 0.5 * variances) + C2;
    float b2 = variances + C2;
    float r = 1.0 / (b1 * b2);
    float s = a1 * a2 * r;
    float by_variance = -s / b2;
    float by_covariance = 2.0 * a1 * r;
    float by_mean = 2.0 * (mu.y * a2 * r - mu.x * s / b1);
    derivatives = vec3(by_mean - 2.0 * m.x * by_variance - m.y * by_covariance, by_variance, by_covariance);
    return s;
}

// Filters a column of the tile. Adds its differences to `sum`.
void filter_column(uint channel, uint column, uint x, uvec2 size, uint top, uint rows, inout float sum) {
    bool inside = column >= WINDOW_RADIUS && column < WINDOW_RADIUS + TILE_X;
    Window window = window_start();
    for (uint begin = 0u; begin < rows + WINDOW_DELAY; begin += AHEAD) {
        vec2 values[AHEAD];
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            values[i] = fetch_or_zero(size, x, top + begin + i - WINDOW_RADIUS, channel);
        }
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            uint k = begin + i;
            vec2 v = values[i];
            if (inside && k - WINDOW_RADIUS < rows) sum += abs(v.x - v.y);
            v -= 0.5;
            vec4 mean = window_next(window, vec4(v, dot(v, v), v.x * v.y));
            if (k >= WINDOW_DELAY) means[(channel * TILE_Y + k - WINDOW_DELAY) * PITCH + column] = mean;
        }
    }
}

// The same by taps, with all outputs of the column in registers.
void add_up_column(uint channel, uint column, uint x, uvec2 size, uint top, uint rows, inout float sum) {
    bool inside = column >= WINDOW_RADIUS && column < WINDOW_RADIUS + TILE_X;
    vec4 mean[TILE_Y];
    [[unroll]] for (uint n = 0u; n < TILE_Y; n++) mean[n] = vec4(0.0);
    [[unroll]] for (uint begin = 0u; begin < TILE_Y + WINDOW_DELAY; begin += AHEAD) {
        vec2 values[AHEAD];
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            values[i] = fetch_or_zero(size, x, top + begin + i - WINDOW_RADIUS, channel);
        }
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            uint k = begin + i;
            vec2 v = values[i];
            if (inside && k - WINDOW_RADIUS < rows) sum += abs(v.x - v.y);
            v -= 0.5;
            vec4 s = vec4(v, dot(v, v), v.x * v.y);
            [[unroll]] for (uint n = 0u; n < TILE_Y; n++) {
                if (k - n < WINDOW_TAPS) mean[n] = fma(vec4(window_tap(k - n)), s, mean[n]);
            }
        }
    }
    [[unroll]] for (uint n = 0u; n < TILE_Y; n++) means[(channel * TILE_Y + n) * PITCH + column] = mean[n];
}

void main() {
    uvec2 size = params.step.camera.size;
    uint tiles_x = (size.x + TILE_X - 1u) / TILE_X;
    uint tiles_y = (size.y + TILE_Y - 1u) / TILE_Y;
    uint tile = folded_workgroup();
    if (tile >= tiles_x * tiles_y) {
        // The tile lies outside: the view is smaller than the largest, or the folded grid has excess workgroups.
        if (gl_LocalInvocationID.x == 0u && tile < sums.length()) sums[tile] = vec2(0.0);
        return;
    }
    uvec2 origin = uvec2(tile % tiles_x, tile / tiles_x) * uvec2(TILE_X, TILE_Y);
    uint rows = min(TILE_Y, size.y - origin.y);
    vec2 sum = vec2(0.0);

    for (uint item = gl_LocalInvocationID.x; item < 3u * COLUMNS; item += WORKGROUP) {
        uint channel = item / COLUMNS, column = item % COLUMNS;
        uint x = origin.x + column - WINDOW_RADIUS; // left of the image, wraps around and fails the comparison
        if (RUN > 1u) filter_column(channel, column, x, size, origin.y, rows, sum.x);
        else add_up_column(channel, column, x, size, origin.y, rows, sum.x);
    }
    barrier();

    const uint runs = TILE_X / RUN;
    for (uint item = gl_LocalInvocationID.x; item < 3u * runs * TILE_Y; item += WORKGROUP) {
        uint run = item % runs, row = item / runs % TILE_Y, channel = item / (runs * TILE_Y);
        uint first = origin.x + run * RUN;
        if (row >= rows || first >= size.x) continue;
        uint count = min(RUN, size.x - first);
        uint from = (channel * TILE_Y + row) * PITCH + run * RUN;
        uint to = (channel * size.y + origin.y + row) * size.x + first;
        vec3 derivatives;
        if (RUN == 1u) {
            vec4 mean = vec4(0.0);
            [[unroll]] for (uint k = 0u; k < WINDOW_TAPS; k++) mean = fma(vec4(window_tap(k)), means[from + k], mean);
            sum.y += ssim(mean, derivatives);
            partials[to] = derivatives;
            continue;
        }
        Window window = window_start();
        for (uint k = 0u; k < count + WINDOW_DELAY; k++) {
            vec4 mean = window_next(window, means[from + k]);
            if (k < WINDOW_DELAY) continue;
            sum.y += ssim(mean, derivatives);
            partials[to + k - WINDOW_DELAY] = derivatives;
        }
    }
    vec2 total = group_sum(sum);
    if (gl_LocalInvocationID.x == 0u) sums[tile] = total;
}

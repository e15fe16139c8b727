// Photometric loss, second half: the gradient by the image's first three channels.
//
// SSIM's derivatives by the windowed means are spread back over the windows (the window is symmetric, so this is the
// same filter), joined with the pixel's own values, and the sign of L1 is added. Tiles, filters and taps as in the first half.
//
// Included with IN_PLACE 0, or 1: then the image has three channels and becomes its own gradient (a pixel's gradient
// needs only that pixel of the image), and the debt of each pixel (blend_bwd.glsl) is written beside it.
#include "common.glsl"
#include "step.glsl"
#define WINDOW_T vec3
#include "window.glsl"

layout(constant_id = 0) const uint WORKGROUP = 96;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILE_X = 22;
layout(constant_id = 3) const uint TILE_Y = 16;
layout(constant_id = 4) const uint RUN = 11;
layout(constant_id = 5) const uint CHANNELS = 3;
layout(constant_id = 6) const uint AHEAD = 2;

layout(scalar) uniform StepBlock { Step step; } params;

#if IN_PLACE
INOUT(float, image); // P x 3; then its gradient
#else
IN(float, image);
#endif
IN(uint, targets);
IN(vec3, partials);
#if IN_PLACE
OUT(float, debt);
#else
OUT(float, grad_image); // P x CHANNELS; the first three are written
#endif

const uint COLUMNS = TILE_X + 2u * WINDOW_RADIUS;
const uint PITCH = COLUMNS | 1u;

shared vec3 spread[3u * TILE_Y * PITCH];
#if IN_PLACE
shared float owed[3u * TILE_Y * TILE_X];
#endif

vec3 partial_or_zero(uvec2 size, uint x, uint y, uint channel) {
    if (AHEAD == 1u && (x >= size.x || y >= size.y)) return vec3(0.0);
    vec3 v = partials[(channel * size.y + min(y, size.y - 1u)) * size.x + min(x, size.x - 1u)];
    return x < size.x && y < size.y ? v : vec3(0.0);
}

void filter_column(uint channel, uint column, uint x, uvec2 size, uint top, uint rows) {
    Window window = window_start();
    for (uint begin = 0u; begin < rows + WINDOW_DELAY; begin += AHEAD) {
        vec3 values[AHEAD];
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            values[i] = partial_or_zero(size, x, top + begin + i - WINDOW_RADIUS, channel);
        }
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            uint k = begin + i;
            vec3 v = window_next(window, values[i]);
            if (k >= WINDOW_DELAY) spread[(channel * TILE_Y + k - WINDOW_DELAY) * PITCH + column] = v;
        }
    }
}

// The same by taps, with all outputs of the column in registers.
void add_up_column(uint channel, uint column, uint x, uvec2 size, uint top) {
    vec3 mean[TILE_Y];
    [[unroll]] for (uint n = 0u; n < TILE_Y; n++) mean[n] = vec3(0.0);
    [[unroll]] for (uint begin = 0u; begin < TILE_Y + WINDOW_DELAY; begin += AHEAD) {
        vec3 values[AHEAD];
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            values[i] = partial_or_zero(size, x, top + begin + i - WINDOW_RADIUS, channel);
        }
        [[unroll]] for (uint i = 0u; i < AHEAD; i++) {
            uint k = begin + i;
            [[unroll]] for (uint n = 0u; n < TILE_Y; n++) {
                if (k - n < WINDOW_TAPS) mean[n] = fma(vec3(window_tap(k - n)), values[i], mean[n]);
            }
        }
    }
    [[unroll]] for (uint n = 0u; n < TILE_Y; n++) spread[(channel * TILE_Y + n) * PITCH + column] = mean[n];
}

void main() {
    uvec2 size = params.step.camera.size;
    uint tiles_x = (size.x + TILE_X - 1u) / TILE_X;
    uint tiles_y = (size.y + TILE_Y - 1u) / TILE_Y;
    uint tile = folded_workgroup();
    if (tile >= tiles_x * tiles_y) return;
    uvec2 origin = uvec2(tile % tiles_x, tile / tiles_x) * uvec2(TILE_X, TILE_Y);
    uint rows = min(TILE_Y, size.y - origin.y);

    for (uint item = gl_LocalInvocationID.x; item < 3u * COLUMNS; item += WORKGROUP) {
        uint channel = item / COLUMNS, column = item % COLUMNS;
        uint x = origin.x + column - WINDOW_RADIUS;
        if (RUN > 1u) filter_column(channel, column, x, size, origin.y, rows);
        else add_up_column(channel, column, x, size, origin.y);
    }
    barrier();

    float mean = 1.0 / (3.0 * float(size.x) * float(size.y));
    float weight_l1 = params.step.weight_l1 * mean;
    float weight_ssim = -params.step.weight_dssim * mean;
    const uint runs = TILE_X / RUN;
    for (uint item = gl_LocalInvocationID.x; item < 3u * runs * TILE_Y; item += WORKGROUP) {
        uint run = item % runs, row = item / runs % TILE_Y, channel = item / (runs * TILE_Y);
        uint first = origin.x + run * RUN;
        if (row >= rows || first >= size.x) continue;
        uint count = min(RUN, size.x - first);
        uint from = (channel * TILE_Y + row) * PITCH + run * RUN;
        uint to = (origin.y + row) * size.x + first;
        vec3 v = vec3(0.0);
        if (RUN == 1u) {
            [[unroll]] for (uint k = 0u; k < WINDOW_TAPS; k++) v = fma(vec3(window_tap(k)), spread[from + k], v);
        }
        Window window = window_start();
        for (uint k = RUN == 1u ? WINDOW_DELAY : 0u; k < count + WINDOW_DELAY; k++) {
            if (RUN > 1u) v = window_next(window, spread[from + k]);
            if (k < WINDOW_DELAY) continue;
            uint pixel = to + k - WINDOW_DELAY;
            uint packed = targets[params.step.target_offset + pixel];
            float y = float(bitfieldExtract(packed, int(8u * channel), 8)) / 255.0;
            float x = image[pixel * CHANNELS + channel];
            // The values are shifted here as they were in the first half.
            float by_ssim = v.x + 2.0 * (x - 0.5) * v.y + (y - 0.5) * v.z;
            float gradient = weight_l1 * sign(x - y) + weight_ssim * by_ssim;
            if (packed >> 24 == 0u) gradient = 0.0;
#if IN_PLACE
            image[pixel * 3u + channel] = gradient;
            owed[(channel * TILE_Y + row) * TILE_X + run * RUN + k - WINDOW_DELAY] = x * gradient;
#else
            grad_image[pixel * CHANNELS + channel] = gradient;
#endif
        }
    }
#if IN_PLACE
    barrier();
    for (uint item = gl_LocalInvocationID.x; item < rows * TILE_X; item += WORKGROUP) {
        uint x = origin.x + item % TILE_X, y = origin.y + item / TILE_X;
        if (x >= size.x) continue;
        float sum = owed[item] + owed[TILE_Y * TILE_X + item];
        debt[y * size.x + x] = sum + owed[2u * TILE_Y * TILE_X + item];
    }
#endif
}

// Photometric loss, second half: the gradient by the image's first three channels.
//
// SSIM's derivatives by the windowed means are spread back over the windows (the window is symmetric, so this is the
// same filter), joined with the pixel's own values, and the sign of L1 is added. Tiles and filters as in the first half.
#version 460
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

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(uint, targets);
IN(vec3, partials);
OUT(float, grad_image); // P x CHANNELS; the first three are written

const uint COLUMNS = TILE_X + 2u * WINDOW_RADIUS;
const uint PITCH = COLUMNS | 1u;

shared vec3 spread[3u * TILE_Y * PITCH];

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
        Window window = window_start();
        for (uint k = 0u; k < rows + WINDOW_DELAY; k++) {
            uint y = origin.y + k - WINDOW_RADIUS;
            vec3 v = vec3(0.0);
            if (x < size.x && y < size.y) v = partials[(channel * size.y + y) * size.x + x];
            v = window_next(window, v);
            if (k >= WINDOW_DELAY) spread[(channel * TILE_Y + k - WINDOW_DELAY) * PITCH + column] = v;
        }
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
        Window window = window_start();
        for (uint k = 0u; k < count + WINDOW_DELAY; k++) {
            vec3 v = window_next(window, spread[from + k]);
            if (k < WINDOW_DELAY) continue;
            uint pixel = to + k - WINDOW_DELAY;
            uint packed = targets[params.step.target_offset + pixel];
            float y = float(bitfieldExtract(packed, int(8u * channel), 8)) / 255.0;
            float x = image[pixel * CHANNELS + channel];
            // The values are shifted here as they were in the first half.
            float by_ssim = v.x + 2.0 * (x - 0.5) * v.y + (y - 0.5) * v.z;
            grad_image[pixel * CHANNELS + channel] = weight_l1 * sign(x - y) + weight_ssim * by_ssim;
        }
    }
}

// Backward of blend, one lane a pixel: sums over pixels are taken once for each splat and tile, in a fixed order.
// Gradients go to the entry of that splat and tile; no atomics.
#version 460
#include "blend_bwd_pixels.glsl"

// Backward of blend: lanes are pixels, sums over them are taken once for each splat and tile, in a fixed order.
// Gradients go to the entry of that splat and tile; nothing is accumulated atomically.
#version 460
#include "blend_bwd_pixels.glsl"

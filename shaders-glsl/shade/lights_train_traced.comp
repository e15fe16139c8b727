// Radiance of pixels with traced shadows from the stored visibility, and the sums that gradients of materials need.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_seen.glsl"
#define SUMS 1
#define SPLIT 0
#include "lights_forward.glsl"

uint stretch_first() { return push.block * PER_LANE * SUBGROUP; }

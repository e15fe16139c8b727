// Radiance of pixels under the lights, and the sums that gradients of materials need.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_none.glsl"
#define SUMS 1
#define SPLIT 0
#include "lights_forward.glsl"

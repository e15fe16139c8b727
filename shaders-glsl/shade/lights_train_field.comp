// Radiance of pixels with shadows from the visibility field, and the sums that gradients of materials need.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#define SUMS 1
#define SPLIT 0
#include "lights_forward.glsl"

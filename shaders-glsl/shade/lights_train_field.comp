// Radiance of pixels under lights that are seen as the visibility field says, and what materials' gradients need.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#define SUMS 1
#define SPLIT 0
#include "lights_forward.glsl"

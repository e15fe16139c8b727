// Radiance of pixels with shadows from the visibility field.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#define SUMS 0
#define SPLIT 0
#include "lights_forward.glsl"

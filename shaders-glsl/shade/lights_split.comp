// Radiance of pixels under the lights, and its diffuse part.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_none.glsl"
#define SUMS 0
#define SPLIT 1
#include "lights_forward.glsl"

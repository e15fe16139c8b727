// Radiance of pixels under lights that are seen as the visibility field says, and its diffuse part.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#define SUMS 0
#define SPLIT 1
#include "lights_forward.glsl"

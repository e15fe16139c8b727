// Radiance of pixels under lights that Gaussians may hide, as traced before, and its diffuse part.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_seen.glsl"
#define SUMS 0
#define SPLIT 1
#include "lights_forward.glsl"

uint stretch_first() { return push.block * PER_LANE * SUBGROUP; }

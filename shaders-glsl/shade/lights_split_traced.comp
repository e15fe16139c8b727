// Radiance of pixels and its diffuse part, with traced shadows from the stored visibility.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_seen.glsl"
#define SUMS 0
#define SPLIT 1
#include "lights_forward.glsl"

uint stretch_first() { return push.block * PER_LANE * SUBGROUP; }

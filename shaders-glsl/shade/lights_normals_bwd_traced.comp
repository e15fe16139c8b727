// Gradients of normals with traced shadows, from the stored visibility.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_seen.glsl"
#include "lights_normals_bwd.glsl"

uint stretch_first() { return push.block * PER_LANE * SUBGROUP; }

// Gradients of lights without shadows.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_none.glsl"
#include "lights_bwd.glsl"

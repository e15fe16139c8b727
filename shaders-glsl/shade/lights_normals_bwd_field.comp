// Gradients of normals under lights that are seen as the visibility field says.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#include "lights_normals_bwd.glsl"

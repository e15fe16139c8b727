// Gradients of normals with shadows from the visibility field.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#include "lights_normals_bwd.glsl"

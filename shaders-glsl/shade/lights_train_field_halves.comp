// As lights_train_field_cooperative.comp, by ordinary instructions: for tests.
#version 460
#define MATRIX_UNITS 0
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#define SUMS 1
#define SPLIT 0
#include "lights_forward.glsl"

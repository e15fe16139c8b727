// As visibility_lights_bwd_cooperative.comp, by ordinary instructions: for tests.
#version 460
#define MATRIX_UNITS 0
#include "visibility_pair_lights.glsl"
#include "visibility_bwd.glsl"

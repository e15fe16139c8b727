// As visibility_bwd_cooperative.comp, by ordinary instructions: for tests.
#version 460
#define MATRIX_UNITS 0
#include "visibility_pair_constant.glsl"
#include "visibility_bwd.glsl"

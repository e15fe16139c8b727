// As visibility_cooperative.comp, by ordinary instructions: for tests.
#version 460
#define MATRIX_UNITS 0
#include "visibility_mean.glsl"

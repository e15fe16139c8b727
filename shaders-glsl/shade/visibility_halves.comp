// As visibility.comp.
// The second layer as on matrix units, by ordinary instructions: for tests.
#version 460
#define MATRIX_UNITS 0
#include "visibility_mean.glsl"

// Backward of the visibility field, first half, under prepared lights.
#version 460
#include "visibility_pair_lights.glsl"
#include "visibility_bwd.glsl"

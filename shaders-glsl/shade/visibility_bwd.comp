// Backward of the visibility field, first half, under lights of constant radiance.
#version 460
#include "visibility_pair_constant.glsl"
#include "visibility_bwd.glsl"

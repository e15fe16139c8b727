// A cube through the lobes of one roughness.
#version 460
#include "common.glsl"
#include "environment_prefilter.glsl"

// The adjoint of environment_prefilter.
#version 460
#include "common.glsl"
#define ADJOINT
#include "environment_prefilter.glsl"

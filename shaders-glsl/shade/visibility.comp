// Visibility of the lights from each pixel by the visibility field: the mean over lights, or one of them.
#version 460
#include "visibility_mean.glsl"

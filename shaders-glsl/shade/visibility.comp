// How much of the lights each pixel sees by the visibility field: the mean over them, or one of them.
#version 460
#include "visibility_mean.glsl"

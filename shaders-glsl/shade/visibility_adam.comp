// Adam for the visibility field's tables, at touched entries.
//
// Clears gradients and bits, whether or not an update was allowed. An entry with a gradient of exactly zero is unchanged.
#version 460
#define PACKED 0
#include "visibility_adam.glsl"

// Adam for the visibility field's tables, at the entries that were touched, a word of 32 bits an invocation. Leaves their
// gradients and bits zero, whether or not anything was allowed to move. What has a gradient of exactly zero stays as it is.
#version 460
#define PACKED 0
#include "visibility_adam.glsl"

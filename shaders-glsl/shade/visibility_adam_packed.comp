// As visibility_adam.comp; also writes each updated entry in 16 bits.
#version 460
#define PACKED 1
#include "visibility_adam.glsl"

// As visibility_adam.comp, and leaves each entry that has moved in 16 bits as well.
#version 460
#define PACKED 1
#include "visibility_adam.glsl"

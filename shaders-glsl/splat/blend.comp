// Blends the splats of a tile front to back.
#version 460
#include "blend.glsl"

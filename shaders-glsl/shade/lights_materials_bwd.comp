// Gradients of albedo and roughness from the sums that shading left.
#version 460
#define METALLIC 0
#include "lights_materials_bwd.glsl"

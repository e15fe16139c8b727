// Gradients of albedo, roughness and metallic from the sums that shading left.
#version 460
#define METALLIC 1
#include "lights_materials_bwd.glsl"

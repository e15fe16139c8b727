// Irradiance of surfels and patches from physical lights of color 1, with shadows.
#version 460
#define PIXELS 0
#include "transport_lights.glsl"

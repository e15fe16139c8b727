// Irradiance of a view's pixels from physical lights of color 1, with shadows.
#version 460
#define PIXELS 1
#include "transport_lights.glsl"

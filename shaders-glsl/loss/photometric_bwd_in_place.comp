// Gradient of the photometric loss in place of the image, with the debt of every pixel, for losses of color only.
#version 460
#define IN_PLACE 1
#include "photometric_bwd.glsl"

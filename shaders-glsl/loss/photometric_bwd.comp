// Gradient of the photometric loss in a separate buffer, beside gradients of further channels.
#version 460
#define IN_PLACE 0
#include "photometric_bwd.glsl"

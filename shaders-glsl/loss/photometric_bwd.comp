// The photometric loss's gradient into a buffer of its own, beside gradients of further channels.
#version 460
#define IN_PLACE 0
#include "photometric_bwd.glsl"

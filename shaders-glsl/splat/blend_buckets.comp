// Blends as blend does, and leaves the state of every pixel before each bucket of entries, for blend_bwd_bucket.
#version 460
#define CHECKPOINTS
#include "blend.glsl"

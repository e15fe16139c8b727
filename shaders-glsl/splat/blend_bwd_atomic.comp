// Backward of blend as blend_bwd, but adds the sums of a splat and tile to the splat's own by atomics.
//
// Buffers hold splats in place of entries. The order of additions varies, so results are not bitwise reproducible.
#version 460
#extension GL_EXT_shader_atomic_float : require
#define ATOMIC
#include "blend_bwd_pixels.glsl"

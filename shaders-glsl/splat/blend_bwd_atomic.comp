// Backward of blend: as blend_bwd, but the sums of a splat and tile are added to the splat's own by atomics, in whatever order
// tiles come. There is room for splats in place of entries; the same step does not leave the same bits.
#version 460
#extension GL_EXT_shader_atomic_float : require
#define ATOMIC
#include "blend_bwd_pixels.glsl"

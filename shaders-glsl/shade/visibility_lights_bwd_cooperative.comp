// As visibility_lights_bwd.comp, with the second layer on cooperative matrices of 16-bit operands: visibility_bwd_matrices.glsl.
#version 460
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#define MATRIX_UNITS 1
#include "visibility_pair_lights.glsl"
#include "visibility_bwd.glsl"

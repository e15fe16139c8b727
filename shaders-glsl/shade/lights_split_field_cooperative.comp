// As lights_split_field.comp, with the second layer on cooperative matrices of 16-bit operands: visibility_matrices.glsl.
#version 460
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#define MATRIX_UNITS 1
#include "common.glsl"
#include "step.glsl"
#include "lights_pixels.glsl"
#include "visibility_lights.glsl"
#define SUMS 0
#define SPLIT 1
#include "lights_forward.glsl"

// Constants and buffers of visibility_bwd.glsl and visibility_bwd_lanes.glsl, which declare the weights. Define FIELD_PIXELS if
// points and coverage are already declared.

layout(constant_id = 10) const uint LEVELS = 16;
layout(constant_id = 11) const bool REGULARIZED = true; // with the smoothness term
layout(constant_id = 12) const bool PLACES = true;      // with gradients by the lights' places
layout(constant_id = 13) const uint SAMPLE = 1;         // one of so many pairs counts, for as many
layout(constant_id = 14) const uint PARTS = 1;          // of the lights; visibility_bwd_lanes.glsl has one

layout(push_constant, scalar) uniform Push {
    uint first; // pixel
    uint count;
    uint most; // lights that there is room for
    float normalizer; // of their radiance
} push;

layout(scalar) uniform FieldBlock { FieldStep field; } field_params;

#ifndef FIELD_PIXELS
IN(vec3, points);
IN(float, coverage);
#endif
IN(float, rows);            // the first layer's response to points, see visibility_encode.comp
IN(float, moved_rows);      // likewise, moved
OUT(float, row_gradients);  // PARTS x count x 32
OUT(float, sums_of);        // by workgroup and side
INOUT(float, place_sums);   // by workgroup and side or group, light
INOUT(float, jitter_sums);  // by workgroup and side: the smoothness term, with its weight; then the largest magnitude of
                            // row_gradients

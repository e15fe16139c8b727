// One layer of a shaded view: linear light over its background, or a blended material.
//
// A view whose buffers overflowed shows the background alone.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "lit.glsl"
#include "coverage.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const bool DIRECT = true;   // light of the trained lights
layout(constant_id = 2) const bool AMBIENT = false; // light of the environment map
layout(constant_id = 3) const bool REST = false;    // less their diffuse parts
layout(constant_id = 4) const uint BEHIND = 0;      // 0 black, 1 a color, 2 the environment map
layout(constant_id = 5) const uint STRIDE = 0;      // no light: floats a pixel of `values`
layout(constant_id = 6) const uint FIRST = 0;       // the one to show
layout(constant_id = 7) const uint COUNT = 1;       // or three from there on
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
layout(scalar) uniform LitBlock { LitStep step; } lit;
IN(float, coverage);
IN(float, blended);         // transmittance
IN(float, direct);          // [pixels * 3] each
IN(float, ambient);
IN(float, direct_rest);
IN(float, ambient_rest);
IN(float, background);
IN(float, values);          // [pixels * STRIDE]
IN(uint, flags);            // [1] not zero if something did not fit
IN(uint, required);           // [1] blending weights that the frame requires
OUT(float, image);          // [pixels * 3]
OUT(float, transmittance);  // [pixels]
INOUT(uint, most);          // [1] most weights that a frame required

void main() {
    uint i = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (i == 0u) most[0] = max(most[0], required[0]);
    uvec2 size = params.step.camera.size;
    if (i >= size.x * size.y) return;
    bool lost = flags[0] != 0u;
    float opacity = coverage[i];
    float c = is_covered(opacity) && !lost ? opacity : 0.0;
    uint at = 3u * i;
    vec3 v = vec3(0.0);
    if (STRIDE > 0u) {
        uint from = STRIDE * i + FIRST;
        v = COUNT == 3u ? vec3(values[from], values[from + 1u], values[from + 2u]) : vec3(values[from]);
        if (lost) v = vec3(0.0);
    } else {
        vec3 factor = lit.step.environment;
        if (DIRECT) v = vec3(direct[at], direct[at + 1u], direct[at + 2u]);
        if (AMBIENT) v += factor * vec3(ambient[at], ambient[at + 1u], ambient[at + 2u]);
        if (REST && DIRECT) v -= vec3(direct_rest[at], direct_rest[at + 1u], direct_rest[at + 2u]);
        if (REST && AMBIENT) v -= factor * vec3(ambient_rest[at], ambient_rest[at + 1u], ambient_rest[at + 2u]);
        v = c > 0.0 ? v * c : vec3(0.0);
        if (BEHIND == 2u) {
            v += (1.0 - c) * factor * vec3(background[at], background[at + 1u], background[at + 2u]);
        }
        v *= lit.step.exposure;
        if (BEHIND == 1u) v += (1.0 - c) * lit.step.behind;
    }
    image[at] = v.x;
    image[at + 1u] = v.y;
    image[at + 2u] = v.z;
    transmittance[i] = lost ? 1.0 : blended[i];
}

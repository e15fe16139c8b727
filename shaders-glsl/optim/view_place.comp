// Step of a view with its learned camera and lens. Zero corrections leave every bit of the camera.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "learned_view.glsl"

layout(constant_id = 0) const uint WORKGROUP = 32;
layout(constant_id = 1) const bool LENS = false;
layout(local_size_x_id = 0) in;

layout(scalar) uniform StepBlock { Step step; } params;
IN(LearnedView, views);
OUT(Step, placed);

void main() {
    if (gl_LocalInvocationID.x != 0u) return;
    Step result = params.step;
    LearnedView view = views[result.view];
    vec3 turn = learned_vector(view, VIEW_TURN), shift = learned_vector(view, VIEW_SHIFT);
    [[unroll]] for (uint r = 0u; r < 3u; ++r) {
        vec4 row = result.camera.world_to_camera[r];
        // The camera turns with its axes, which are the rows. The center stays where it is: t = -row . center.
        vec3 change = turned_by(turn, row.xyz);
        row.xyz += change;
        row.w -= dot(change, result.camera.position) + dot(row.xyz, shift);
        result.camera.world_to_camera[r] = row;
    }
    result.camera.position += shift;
    if (LENS) {
        LearnedView lens = views[views.length() - 1u];
        vec2 focal = result.camera.focal;
        result.camera.center += focal * vec2(lens.values[LENS_CENTER], lens.values[LENS_CENTER + 1u]);
        result.camera.focal = focal * exp(lens.values[LENS_FOCAL]);
        result.camera.radial = lens.values[LENS_RADIAL];
    }
    placed[0] = result;
}

// Densification, step 6 for semantic features: copies the rows of Gaussians, as densify_move copies columns.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint WIDTH = 32; // features of a Gaussian

IN(Work, moves);
IN(Move, entries);
INOUT(float, features);
INOUT(vec2, moments);

void main() {
    uint count = moves[0].count * WIDTH;
    uint stride = gl_NumWorkGroups.x * gl_NumWorkGroups.y * WORKGROUP;
    for (uint t = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x; t < count; t += stride) {
        Move move = entries[t / WIDTH];
        if (move.kind == PRUNE) continue;
        uint k = t % WIDTH;
        uint from = move.from * WIDTH + k, home = move.home * WIDTH + k;
        float feature = features[from];
        if (home != from) features[home] = feature;
        if (move.kind == SPLIT) moments[home] = vec2(0.0);
        else if (home != from) moments[home] = moments[from];
        if (move.child != NOWHERE) {
            uint child = move.child * WIDTH + k;
            features[child] = feature;
            moments[child] = vec2(0.0);
        }
    }
}

// Densification, step 6: copies the columns of Gaussians. A moved Gaussian keeps its moments; a new one, including both halves
// of a split, starts with zero moments.
#version 460
#include "common.glsl"
#include "work.glsl"
#include "densify.glsl"
#include "gaussian.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;

IN(Work, moves);
IN(Move, entries);
INOUT(vec4, parameters);
INOUT(vec4, first_moments);
INOUT(vec4, second_moments);

void main() {
    uint count = moves[0].count * COLUMNS;
    uint stride = gl_NumWorkGroups.x * gl_NumWorkGroups.y * WORKGROUP;
    for (uint t = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x; t < count; t += stride) {
        Move move = entries[t / COLUMNS];
        if (move.kind == PRUNE) continue;
        uint column = t % COLUMNS;
        uint from = column_of(move.from, column), home = column_of(move.home, column);
        vec4 parameter = parameters[from];
        if (home != from) parameters[home] = parameter;
        if (move.kind == SPLIT) first_moments[home] = second_moments[home] = vec4(0.0);
        else if (home != from) {
            first_moments[home] = first_moments[from];
            second_moments[home] = second_moments[from];
        }
        if (move.child != NOWHERE) {
            uint child = column_of(move.child, column);
            parameters[child] = parameter;
            first_moments[child] = second_moments[child] = vec4(0.0);
        }
    }
}

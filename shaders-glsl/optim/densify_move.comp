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
INOUT(uvec4, parameters);
INOUT(uvec4, first_moments);
INOUT(uvec4, second_moments);

void copy_moments(uint from, uint to) {
    first_moments[to] = first_moments[from];
    if (!COMPACT) second_moments[to] = second_moments[from];
}

void clear_moments(uint at) {
    first_moments[at] = uvec4(0u);
    if (!COMPACT) second_moments[at] = uvec4(0u);
}

void main() {
    uint count = moves[0].count * MOMENT_COLUMNS;
    uint stride = gl_NumWorkGroups.x * gl_NumWorkGroups.y * WORKGROUP;
    for (uint t = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x; t < count; t += stride) {
        Move move = entries[t / MOMENT_COLUMNS];
        if (move.kind == PRUNE) continue;
        uint column = t % MOMENT_COLUMNS;
        // Compact storage has fewer columns of parameters.
        if (column < COLUMNS) {
            uint from = column_of(move.from, column), home = column_of(move.home, column);
            uvec4 parameter = parameters[from];
            if (home != from) parameters[home] = parameter;
            if (move.child != NOWHERE) parameters[column_of(move.child, column)] = parameter;
        }
        uint from = moments_of(move.from, column), home = moments_of(move.home, column);
        if (move.kind == SPLIT) clear_moments(home);
        else if (home != from) copy_moments(from, home);
        if (move.child != NOWHERE) clear_moments(moments_of(move.child, column));
    }
}

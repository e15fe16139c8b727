// March of all invocations over a tile's values, which stores the slopes; see tile_filters.glsl.
//
// Call tile_slopes() once, from uniform control flow, after a barrier behind the values; it ends with one. Needs a type March
// and functions:
//     March march_begin(uint at)  from the values of the first two rows of a run
//     void march_next(inout March m, uint column, uint row, out vec4 x, out vec4 y)
//                                 the slopes of the next pixel, at a place with one pixel of margin

void tile_slopes() {
    if (REUSE) {
        // Invocations beyond the runs have no rows.
        uint item = gl_LocalInvocationID.x, column = item % SLOPE_X, first = item / SLOPE_X * RUN;
        vec4 x[RUN], y[RUN];
        March m = march_begin(min(first, SLOPE_Y - 1u) * DATA_X + column);
        [[unroll]] for (uint i = 0u; i < RUN; i++) {
            if (first + i < SLOPE_Y) march_next(m, column, first + i, x[i], y[i]);
        }
        barrier();
        [[unroll]] for (uint i = 0u; i < RUN; i++) {
            if (first + i < SLOPE_Y) set_tile_slopes((first + i) * SLOPE_X + column, x[i], y[i]);
        }
    } else {
        for (uint item = gl_LocalInvocationID.x; item < SLOPE_RUNS; item += WORKGROUP) {
            uint column = item % SLOPE_X, first = item / SLOPE_X * RUN, end = min(first + RUN, SLOPE_Y);
            March m = march_begin(first * DATA_X + column);
            for (uint row = first; row < end; row++) {
                vec4 x, y;
                march_next(m, column, row, x, y);
                set_tile_slopes(row * SLOPE_X + column, x, y);
            }
        }
    }
    barrier();
}

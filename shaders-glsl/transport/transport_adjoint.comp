// One step of the adjoint of bounces: every receiver gathers from the receivers whose rays meet it. See transport_step.glsl.
//
// Four entries an iteration keep the iterations of a receiver that most rays meet within llvmpipe's limit (65535).
#version 460
#include "common.glsl"
#include "transport_images.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(constant_id = 1) const uint LANES = 8; // of a receiver
layout(local_size_x_id = 0) in;
#include "transport_step.glsl"

IN(uint, column_starts); // [receivers + 1]
IN(uint, column_rows);   // receivers whose rays meet the column's

vec3 transport_gather(uint receiver, uint light, uint lane) {
    vec3 sum = vec3(0.0);
    uint end = column_starts[receiver + 1u];
    for (uint e = column_starts[receiver] + lane; e < end; e += 4u * LANES) {
        [[unroll]] for (uint k = 0u; k < 4u; k++) {
            // The texel after the receivers' is zero.
            uint from = e + k * LANES < end ? column_rows[e + k * LANES] : push.receivers;
            sum += imageLoad(current, transport_texel(from, light, push.rows)).xyz;
        }
    }
    return sum;
}

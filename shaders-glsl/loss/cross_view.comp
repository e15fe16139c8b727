// Cross-view loss: distances of a region's mean albedo in pseudo-views from that in the training view.
//
// Also computes the gradient of each pixel of the region. One workgroup.
#version 460
#include "common.glsl"
#include "material_weights.glsl"
#include "cross_view.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint VIEWS = 3; // the training view and pseudo-views

#define SUM_T vec4
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    uint count; // number of sums of a view
    uint pitch; // stride from one view to the next
} push;

layout(scalar) uniform WeightsBlock { MaterialWeights weights; } loss_weights;

IN(vec4, sums);           // by view and workgroup: albedo, number of pixels
OUT(CrossRegion, regions); // by view, the training view first

void main() {
    vec4 trained = vec4(0.0);
    vec3 pull = vec3(0.0);
    for (uint k = 0u; k < VIEWS; k++) {
        vec4 sum = vec4(0.0);
        for (uint i = gl_LocalInvocationID.x; i < push.count; i += WORKGROUP) sum += sums[k * push.pitch + i];
        barrier(); // before the shared sums are written again
        sum = group_sum(sum);
        sum.rgb /= max(sum.w, 1.0);
        if (k == 0u) {
            trained = sum;
        } else if (gl_LocalInvocationID.x == 0u) {
            vec3 difference = sum.rgb - trained.rgb;
            bool counts = min(sum.w, trained.w) >= LEAST_PIXELS;
            float apart = counts ? length(difference) : 0.0;
            vec3 direction = apart > 0.0 ? loss_weights.weights.cross_view * difference / apart : vec3(0.0);
            regions[k] = CrossRegion(sum.rgb, sum.w, direction / max(sum.w, 1.0), apart);
            pull -= direction;
        }
    }
    if (gl_LocalInvocationID.x != 0u) return;
    regions[0] = CrossRegion(trained.rgb, trained.w, pull / max(trained.w, 1.0), 0.0);
}

// Sums the partial losses of workgroups in a fixed order into the step's record. One workgroup.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "loss_stats.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool GEOMETRY = false; // whether there are sums of the geometry losses
layout(constant_id = 3) const bool DEPTH = false;    // whether losses of prior depths follow them

#define SUM_T vec4
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    uint photometric_count; // workgroups that wrote sums
    uint geometry_count;
} push;

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec2, photometric_sums); // |x - y|, SSIM
IN(vec4, geometry_sums);    // normal, normal smoothness, depth smoothness, depth variance; then of prior depths, in x
OUT(LossStats, stats);

void main() {
    uint first = gl_LocalInvocationID.x;
    vec4 photometric = vec4(0.0);
    for (uint i = first; i < push.photometric_count; i += WORKGROUP) photometric.xy += photometric_sums[i];
    photometric = group_sum(photometric);
    vec4 geometry = vec4(0.0);
    if (GEOMETRY) {
        for (uint i = first; i < push.geometry_count; i += WORKGROUP) geometry += geometry_sums[i];
        barrier(); // before the shared sums are written again
        geometry = group_sum(geometry);
    }
    float depth = 0.0;
    if (DEPTH) {
        for (uint i = first; i < push.geometry_count; i += WORKGROUP) depth += geometry_sums[push.geometry_count + i].x;
        barrier();
        depth = group_sum(vec4(depth)).x;
    }
    if (first != 0u) return;
    Step s = params.step;
    float pixels = float(s.camera.size.x) * float(s.camera.size.y);
    photometric /= 3.0 * pixels;
    geometry /= vec4(1.0, 3.0, 1.0, 1.0) * pixels;
    LossStats r;
    r.l1 = photometric.x;
    r.ssim = photometric.y;
    r.normal = geometry.x;
    r.normal_smooth = geometry.y;
    r.depth_smooth = geometry.z;
    r.depth_variance = geometry.w;
    r.depth = depth / pixels;
    // semantic_sum adds the semantic losses, if any.
    r.semantic = 0.0;
    r.semantic_class = 0.0;
    r.correspondence = 0.0;
    r.correspondence_class = 0.0;
    r.semantic_excluded = 0u;
    r.correspondence_pairs = 0u;
    r.total = s.weight_l1 * r.l1 + s.weight_dssim * (1.0 - r.ssim);
    if (GEOMETRY) {
        r.total += s.weight_normal * r.normal + s.weight_normal_smooth * r.normal_smooth
                 + s.weight_depth_smooth * r.depth_smooth + s.weight_depth_variance * r.depth_variance
                 + s.weight_depth * r.depth;
    }
    stats[0] = r;
}

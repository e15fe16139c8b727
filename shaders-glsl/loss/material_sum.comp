// Sums the material losses into one record. One workgroup.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "msg.glsl"
#include "cross_view.glsl"
#include "material_weights.glsl"
#include "material_stats.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const bool MSG = true;    // whether the multi-scale gradient loss is on
layout(constant_id = 3) const uint VIEWS = 3;  // views of the cross-view loss; 0 if it is off
layout(constant_id = 4) const uint ESTIMATES = 2; // albedo estimates under other light
layout(constant_id = 5) const uint GRAY_ESTIMATES = 0; // roughness estimates under other light
layout(constant_id = 6) const bool OWN_PRIOR = false;  // whether the region is compared with the view's own prior

#define SUM_T vec3
#include "group_sum.glsl"

layout(push_constant, scalar) uniform Push {
    uint compose_count; // workgroups that wrote sums
    uint edge_count;
    float roughness_share; // weight of roughness estimates relative to albedo estimates
} push;

layout(scalar) uniform StepBlock { Step step; } params;
layout(scalar) uniform WeightsBlock { MaterialWeights weights; } loss_weights;

IN(float, compose_sums);
IN(vec2, edge_sums);
IN(MsgLevels, msg);
IN(CrossRegion, regions);
IN(MsgLevels, relight_first);
IN(MsgLevels, relight_second);
IN(MsgLevels, roughness_first);
IN(MsgLevels, roughness_second);
IN(MsgLevels, own);
OUT(MaterialStats, stats);

void main() {
    uint first = gl_LocalInvocationID.x;
    vec3 sum = vec3(0.0);
    for (uint i = first; i < push.compose_count; i += WORKGROUP) sum.x += compose_sums[i];
    for (uint i = first; i < push.edge_count; i += WORKGROUP) sum.yz += edge_sums[i];
    sum = group_sum(sum);
    if (first != 0u) return;
    sum /= vec3(1.0, 3.0, 1.0) * float(params.step.camera.size.x) * float(params.step.camera.size.y);
    MaterialStats r = MaterialStats(0.0, 0.0, 0.0, sum.y, sum.z, 0.0, 0.0, 0.0, sum.x, 0u, 0u, 0u);
    if (MSG) {
        r.albedo_msg = msg[0].albedo;
        r.roughness_msg = msg[0].roughness;
    }
    for (uint k = 1u; k < VIEWS; k++) {
        r.cross_view += regions[k].apart;
        r.cross_pairs += uint(min(regions[0].count, regions[k].count) >= LEAST_PIXELS);
    }
    if (ESTIMATES > 0u) {
        r.relight += relight_first[0].square + relight_first[0].albedo;
        r.relight_count += uint(relight_first[0].pixels > 0.0);
    }
    if (ESTIMATES > 1u) {
        r.relight += relight_second[0].square + relight_second[0].albedo;
        r.relight_count += uint(relight_second[0].pixels > 0.0);
    }
    r.relight /= float(max(ESTIMATES, 1u));
    float gray = 0.0;
    if (GRAY_ESTIMATES > 0u) gray += roughness_first[0].square + roughness_first[0].albedo;
    if (GRAY_ESTIMATES > 1u) gray += roughness_second[0].square + roughness_second[0].albedo;
    r.relight += push.roughness_share / float(max(GRAY_ESTIMATES, 1u)) * gray;
    if (OWN_PRIOR) {
        r.own_prior = own[0].square + own[0].albedo;
        r.own_count = uint(own[0].pixels > 0.0);
    }
    MaterialWeights w = loss_weights.weights;
    r.total = w.albedo_msg * r.albedo_msg + w.roughness_msg * r.roughness_msg + w.albedo_edge * r.albedo_edge
            + w.roughness_edge * r.roughness_edge + w.cross_view * r.cross_view + w.relight * r.relight
            + w.own_prior * r.own_prior;
    stats[0] = r;
}

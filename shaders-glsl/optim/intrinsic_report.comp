// One record of an intrinsic step into a ring that the host reads some steps later.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "loss_stats.glsl"
#include "material_stats.glsl"

layout(constant_id = 0) const uint RING = 64;
layout(constant_id = 1) const bool ALBEDO = false;    // whether there was a prior
layout(constant_id = 2) const bool ROUGHNESS = false;
layout(constant_id = 3) const bool METALLIC = false;
layout(constant_id = 4) const bool LIGHTS = false;    // whether lights are regularized
const uint WORKGROUP = 64;
layout(local_size_x = WORKGROUP) in;

layout(push_constant, scalar) uniform Push {
    uint smooth_count; // workgroups that left sums of the environment's smoothness; 0 if it has no weight
    uint jitter_count; // likewise of the visibility field's jitter
} push;

struct IntrinsicReport {
    uint step;
    uint skipped;          // gradients that were not finite, so far
    float shaded;          // weighted loss of the shaded image
    float shaded_l1;
    float shaded_ssim;
    float albedo;          // weighted losses of the priors
    float roughness;
    float metallic;
    float light_position;     // means before their weights
    float light_value;
    float environment_smooth;
    float visibility_jitter;  // with its weight
    float recent_cross_view;  // of the last step that compared so; below 0 before the first. The host fills these in
    float recent_relight;
    float recent_own_prior;
    MaterialStats materials;
};

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, skipped);
IN(LossStats, shaded);
IN(LossStats, albedo);
IN(LossStats, roughness);
IN(LossStats, metallic);
IN(MaterialStats, materials);
IN(float, light_losses);
IN(float, smooth_sums);
IN(float, jitter_sums);
OUT(IntrinsicReport, reports);

shared vec2 parts[WORKGROUP]; // of the sums of workgroups: smoothness, jitter

void main() {
    uint own = gl_LocalInvocationID.x;
    vec2 part = vec2(0.0);
    for (uint i = own; i < push.smooth_count; i += WORKGROUP) part.x += smooth_sums[i];
    for (uint i = own; i < push.jitter_count; i += WORKGROUP) part.y += jitter_sums[i];
    parts[own] = part;
    barrier();
    if (own > 0u) return;
    for (uint i = 1u; i < WORKGROUP; i++) part += parts[i];
    float smoothness = part.x, jitter = part.y;
    LossStats s = shaded[0];
    float a = 0.0, r = 0.0, m = 0.0;
    if (ALBEDO) a = albedo[0].total;
    if (ROUGHNESS) r = roughness[0].total;
    if (METALLIC) m = metallic[0].total;
    vec2 lights = vec2(0.0);
    if (LIGHTS) lights = vec2(light_losses[0], light_losses[1]);
    reports[params.step.step % RING] =
        IntrinsicReport(params.step.step, skipped[0], s.total, s.l1, s.ssim, a, r, m, lights.x, lights.y, smoothness, jitter,
                        -1.0, -1.0, -1.0, materials[0]);
}

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
layout(local_size_x = 1) in;

struct IntrinsicReport {
    uint step;
    uint skipped;          // gradients that were not finite, so far
    float shaded;          // weighted loss of the shaded picture
    float shaded_l1;
    float shaded_ssim;
    float albedo;          // weighted losses of the priors
    float roughness;
    float metallic;
    MaterialStats materials;
};

layout(scalar) uniform StepBlock { Step step; } params;
IN(uint, skipped);
IN(LossStats, shaded);
IN(LossStats, albedo);
IN(LossStats, roughness);
IN(LossStats, metallic);
IN(MaterialStats, materials);
OUT(IntrinsicReport, reports);

void main() {
    LossStats s = shaded[0];
    float a = 0.0, r = 0.0, m = 0.0;
    if (ALBEDO) a = albedo[0].total;
    if (ROUGHNESS) r = roughness[0].total;
    if (METALLIC) m = metallic[0].total;
    reports[params.step.step % RING] =
        IntrinsicReport(params.step.step, skipped[0], s.total, s.l1, s.ssim, a, r, m, materials[0]);
}

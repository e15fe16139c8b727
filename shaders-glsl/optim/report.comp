// One record of a step into a ring that the host reads some steps later: counts, flags, losses.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "loss_stats.glsl"

layout(constant_id = 0) const uint RING = 64;
layout(constant_id = 1) const uint PSEUDO = 0; // other views of the step, whose entries share the room
layout(local_size_x = 1) in;

struct StepReport {
    uint step;
    uint gaussians;
    uint visible;
    uint entries;  // required by the view that requires most; more than the capacity if `flags` is set
    uint flags;
    uint skipped;  // splats whose gradients were not finite
    LossStats losses;
};

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, gaussians);
IN(Work, visible);
IN(uint, required);
IN(uint, required0);
IN(uint, required1);
IN(uint, flags);
IN(uint, skipped);
IN(LossStats, losses);
OUT(StepReport, reports);

void main() {
    uint entries = required[0];
    if (PSEUDO >= 1u) entries = max(entries, required0[0]);
    if (PSEUDO >= 2u) entries = max(entries, required1[0]);
    reports[params.step.step % RING] =
        StepReport(params.step.step, gaussians[0].count, visible[0].count, entries, flags[0], skipped[0], losses[0]);
}

// Adam for what is learned of the step's view, and the gauge: the mean over all views is zero.
//
// One workgroup. Gradients come in parts, of workgroups of earlier kernels, and are added in order. A raised flag leaves
// everything unchanged.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "work.glsl"
#include "adam.glsl"
#include "learned_view.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const bool CAMERAS = true;
layout(constant_id = 2) const bool GAINS = true;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint count;         // of the views
    uint per_group;     // visible splats of a part of the camera's gradients
    uint gain_parts;    // parts of the gains' gradients
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(uint, flags);
IN(float, camera_parts);  // [parts * 6]: by turn and shift
IN(float, gain_parts);    // [parts * 3]
INOUT(LearnedView, views);
INOUT(uint, skipped);     // gradients that were not finite

const uint ROWS = WORKGROUP / 16u;

shared float sums[WORKGROUP];
shared float means[VIEW_VALUES];

// Sum over the parts of number `k` of `width`; of all rows of sixteen invocations together.
float part(uint first, uint k, uint parts, bool cameras) {
    float sum = 0.0;
    for (uint p = first; p < parts; p += ROWS) sum += cameras ? camera_parts[6u * p + k] : gain_parts[3u * p + k];
    return sum;
}

const float LOG_BETA1 = -0.10536051565782628; // of 0.9
const float LOG_BETA2 = -0.0010005003335835335; // of 0.999

// 1 - beta^t, by a series where the difference would lose digits.
float share_of(float t, float log_beta) {
    float x = t * log_beta;
    float series = 1.0 + x / 2.0 * (1.0 + x / 3.0 * (1.0 + x / 4.0 * (1.0 + x / 5.0 * (1.0 + x / 6.0))));
    return x > -0.3 ? -x * series : 1.0 - exp(x);
}

void main() {
    if (by_workgroup(flags[0]) != 0u) return;
    uint lane = gl_LocalInvocationID.x, k = lane % 16u, row = lane / 16u;
    uint splats = visible[0].count;
    uint camera_count = CAMERAS ? splats / push.per_group + uint(splats % push.per_group != 0u) : 0u;
    float mine = 0.0;
    if (CAMERAS && k < VIEW_GAIN) mine = part(row, k, camera_count, true);
    if (GAINS && k >= VIEW_GAIN && k < VIEW_VALUES) mine = part(row, k - VIEW_GAIN, push.gain_parts, false);
    sums[lane] = mine;
    barrier();
    uint at = params.step.view;
    if (lane < VIEW_VALUES) {
        float gradient = 0.0;
        for (uint r = 0u; r < ROWS; ++r) gradient += sums[16u * r + lane];
        bool learned = lane < VIEW_GAIN ? CAMERAS : GAINS;
        float rate = lane < VIEW_SHIFT  ? params.step.lr_turn
                     : lane < VIEW_GAIN ? params.step.lr_shift
                                        : params.step.lr_gain;
        if (learned && !is_finite(gradient)) {
            atomicAdd(skipped[0], 1u);
        } else if (learned && rate > 0.0) {
            // A view's own steps count: most steps are of other views.
            float t = float(views[at].steps + 1u);
            float value = views[at].values[lane];
            vec2 moments = views[at].moments[lane];
            adam(value, moments, gradient, rate, 1.0 / share_of(t, LOG_BETA1), 1.0 / share_of(t, LOG_BETA2));
            views[at].values[lane] = value;
            views[at].moments[lane] = moments;
        }
    }
    memoryBarrierBuffer();
    barrier();
    if (lane == 0u) views[at].steps += 1u;
    // The only view of a graph is not among others whose mean it could keep.
    if (push.count < 2u) return;
    // Rows of sixteen add the values of every ROWS-th view.
    float sum = 0.0;
    if (k < VIEW_VALUES) for (uint v = row; v < push.count; v += ROWS) sum += views[v].values[k];
    sums[lane] = sum;
    barrier();
    if (lane < VIEW_VALUES) {
        float total = 0.0;
        for (uint r = 0u; r < ROWS; ++r) total += sums[16u * r + lane];
        means[lane] = total / float(push.count);
    }
    barrier();
    if (k < VIEW_VALUES) for (uint v = row; v < push.count; v += ROWS) views[v].values[k] -= means[k];
}

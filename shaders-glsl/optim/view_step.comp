// Adam for what is learned of the step's view and of the lens, and the gauge: the mean over all views is zero.
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
layout(constant_id = 3) const bool LENS = false;
layout(local_size_x_id = 0) in;

layout(push_constant, scalar) uniform Push {
    uint count;         // of the views
    uint per_group;     // visible splats of a part of the camera's gradients
    uint gain_parts;    // parts of the gains' gradients
} push;

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, visible);
IN(uint, flags);
IN(float, camera_parts);  // [parts * 6], or 10 with the lens: by turn and shift; by focal lengths, principal point, distortion
IN(float, gain_parts);    // [parts * 3], or 4 with the lens: by the vignetting at last
INOUT(LearnedView, views);
INOUT(uint, skipped);     // gradients that were not finite

const uint ROWS = WORKGROUP / 16u;

shared float sums[WORKGROUP];
shared float means[VIEW_VALUES];

// Numbers of a step: those of the view, then those of the lens.
const uint NUMBERS = VIEW_VALUES + (LENS ? LENS_VALUES : 0u);
const uint CAMERA_WIDTH = LENS ? 10u : 6u, GAIN_WIDTH = LENS ? 4u : 3u;

// Distorted images do not fold before their corners.
const float MAX_RADIAL = 0.1;

// Sum over the parts of number `k`; of all rows of sixteen invocations together.
float part(uint first, uint k, uint parts, bool cameras) {
    float sum = 0.0;
    for (uint p = first; p < parts; p += ROWS) {
        sum += cameras ? camera_parts[CAMERA_WIDTH * p + k] : gain_parts[GAIN_WIDTH * p + k];
    }
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
    uint camera_count = CAMERAS || LENS ? splats / push.per_group + uint(splats % push.per_group != 0u) : 0u;
    float mine = 0.0;
    if (CAMERAS && k < VIEW_GAIN) mine = part(row, k, camera_count, true);
    if (GAINS && k >= VIEW_GAIN && k < VIEW_VALUES) mine = part(row, k - VIEW_GAIN, push.gain_parts, false);
    uint of_lens = k - VIEW_VALUES;
    if (LENS && of_lens < LENS_INTRINSICS) mine = part(row, VIEW_GAIN + of_lens, camera_count, true);
    if (LENS && of_lens == LENS_RADIAL) mine = part(row, VIEW_GAIN + LENS_INTRINSICS, camera_count, true);
    if (LENS && GAINS && of_lens == LENS_VIGNETTING) mine = part(row, 3u, push.gain_parts, false);
    sums[lane] = mine;
    // Gradients are by a shift in learned focal lengths; values are in given ones.
    float shift_unit = LENS ? exp(-views[push.count].values[LENS_FOCAL]) : 1.0;
    barrier();
    bool shared_by_all = LENS && lane >= VIEW_VALUES;
    uint at = shared_by_all ? push.count : params.step.view;
    if (lane < NUMBERS) {
        float gradient = 0.0;
        for (uint r = 0u; r < ROWS; ++r) gradient += sums[16u * r + lane];
        uint value_at = shared_by_all ? lane - VIEW_VALUES : lane;
        bool color = shared_by_all ? value_at == LENS_VIGNETTING : lane >= VIEW_GAIN;
        bool learned = color ? GAINS : CAMERAS || shared_by_all;
        float rate = color           ? params.step.lr_gain
                     : shared_by_all ? (value_at == LENS_RADIAL ? params.step.lr_radial : params.step.lr_lens)
                     : lane < VIEW_SHIFT ? params.step.lr_turn
                                         : params.step.lr_shift;
        if (shared_by_all && value_at >= LENS_CENTER && value_at < LENS_VIGNETTING) gradient *= shift_unit;
        if (learned && !is_finite(gradient)) {
            atomicAdd(skipped[0], 1u);
        } else if (learned && rate > 0.0) {
            // A view's own steps count: most steps are of other views.
            float t = float(views[at].steps + 1u);
            float value = views[at].values[value_at];
            vec2 moments = views[at].moments[value_at];
            adam(value, moments, gradient, rate, 1.0 / share_of(t, LOG_BETA1), 1.0 / share_of(t, LOG_BETA2));
            bool radial = shared_by_all && value_at == LENS_RADIAL;
            views[at].values[value_at] = radial ? clamp(value, -MAX_RADIAL, MAX_RADIAL) : value;
            views[at].moments[value_at] = moments;
        }
    }
    memoryBarrierBuffer();
    barrier();
    if (lane == 0u) views[at].steps += 1u;
    if (LENS && lane == VIEW_VALUES) views[at].steps += 1u;
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

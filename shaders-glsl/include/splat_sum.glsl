// Shared part of the kernels of project_bwd: sums one visible splat's gradients over its entries and takes them back
// through projection. Included after large_splats.glsl, and after the buffers and constants that it names are declared.

#include "parameter_columns.glsl"

// Of an entry: moments, colors, weight, and the statistic's own moments.
const uint SUMS = 6u + CHANNELS + WEIGHTS + STATISTIC_FLOATS;

void add_entry_gradients(inout float sums[SUMS], uint e) {
    [[unroll]] for (uint j = 0u; j < SUMS; ++j) sums[j] += entry_gradients[e * SUMS + j];
}

// Moments that came through features; the features' own gradients are summed elsewhere (features_bwd).
void add_entry_features(inout float sums[SUMS], uint e) {
    if (entry_flags[e] == 0u) return;
    [[unroll]] for (uint j = 0u; j < 6u; ++j) sums[j] += entry_features[e * (6u + FEATURES) + j];
}

// Sums over the entries of the splat of each lane. A lane adds those of a small splat in order. All lanes together add
// those of a large one, each every SUBGROUP-th entry. Where entries' gradients have been added up already (REDUCED), each
// splat has one.
void sum_entries(uint v, bool there, out float sums[SUMS]) {
    [[unroll]] for (uint j = 0u; j < SUMS; ++j) sums[j] = 0.0;
    uint first = there ? entry_starts[v] : 0u, count = there ? tile_counts[v] : 0u;
    bool large = count > LARGE_TILES;
    if (REDUCED && there) add_entry_gradients(sums, v);
    uint own = large ? 0u : count;
    if (!REDUCED) for (uint e = first; e < first + own; ++e) add_entry_gradients(sums, e);
    if (FEATURES > 0u) for (uint e = first; e < first + own; ++e) add_entry_features(sums, e);
    if (REDUCED && FEATURES == 0u) return;
    uvec4 votes = subgroupBallot(large);
    while (any(notEqual(votes, uvec4(0u)))) {
        uint lane = next_large(votes);
        uint begin = subgroupShuffle(first, lane), end = begin + subgroupShuffle(count, lane);
        float part[SUMS];
        [[unroll]] for (uint j = 0u; j < SUMS; ++j) part[j] = 0.0;
        for (uint e = begin + gl_SubgroupInvocationID; e < end; e += SUBGROUP) {
            if (!REDUCED) add_entry_gradients(part, e);
            if (FEATURES > 0u) add_entry_features(part, e);
        }
        [[unroll]] for (uint j = 0u; j < SUMS; ++j) {
            float total = lane_tree_sum(part[j]);
            if (lane == gl_SubgroupInvocationID) sums[j] += total;
        }
    }
}

struct Visible {
    uint gaussian;
    vec3 mean;
    vec3 log_scale;
    vec4 rotation;
    float opacity_logit;
    vec3 color;          // d/d(color), zero where the color was cut off at black
    vec3 direction;      // unit, camera to mean
    float inverse_range; // 1 / distance
    vec3 normal;         // d/d(raw normal)
    float weight;        // sum of blending weights, if requested
    vec2 statistic;      // screen gradient of the losses that enter the statistic of densification, pixels
    SplatGradient gradient;
    bool touched;        // anything but zeros
};

// `sums` are the splat's of `sum_entries`.
Visible visible_splat(uint v, float sums[SUMS]) {
    Camera camera = params.step.camera;
    Visible s;
    s.gaussian = splat_ids[v];
    float moments[6];
    float colors[CHANNELS];
    [[unroll]] for (uint j = 0u; j < 6u; ++j) moments[j] = sums[j];
    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) colors[c] = sums[6u + c];
    s.weight = WEIGHTS > 0u ? sums[(6u + CHANNELS) % SUMS] : 0.0;
    vec2 statistic = vec2(0.0);
    if (STATISTIC_FLOATS > 0u) {
        const uint own = 6u + CHANNELS + WEIGHTS;
        statistic = vec2(sums[own % SUMS], sums[(own + 1u) % SUMS]);
    }
    uint any_gradient = 0u;
    [[unroll]] for (uint j = 0u; j < 6u; ++j) any_gradient |= magnitude_bits(moments[j]);
    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) any_gradient |= magnitude_bits(colors[c]);
    s.touched = any_gradient != 0u;
    vec4 place = parameter_column(s.gaussian, 0u);
    s.mean = place.xyz;
    s.opacity_logit = place.w;
    s.log_scale = parameter_column(s.gaussian, 1u).xyz;
    s.rotation = parameter_column(s.gaussian, 2u);
    Projection p;
    project_splat(camera, s.mean, s.log_scale, s.rotation, s.opacity_logit, p);
    uint at = v * CHANNEL_WORDS;
    vec3 stored_color = color_of_words(features[at], features[at + 1u], COLOR_BITS == 16u ? 0u : features[at + 2u]);
    s.color = vec3(stored_color.x > 0.0 ? colors[0] : 0.0, stored_color.y > 0.0 ? colors[1u % CHANNELS] : 0.0,
                   stored_color.z > 0.0 ? colors[2u % CHANNELS] : 0.0);
    float depth = 0.0;
    if (HAS_DEPTH) {
        // The last two channels: z and z²; the largest z that they tell has no gradient.
        float z = p.point.z;
        if (z < DEPTH_MAX) depth = colors[(CHANNELS - 2u) % CHANNELS] + 2.0 * z * colors[(CHANNELS - 1u) % CHANNELS];
    }
    s.normal = vec3(0.0);
    if (HAS_NORMALS) {
        vec3 d = vec3(colors[3u % CHANNELS], colors[4u % CHANNELS], colors[5u % CHANNELS]);
        vec3 raw = parameter_column(s.gaussian, COLUMNS - 1u).xyz;
        float n = length(raw);
        // n / max(|n|, 1e-3): below the floor the map is linear.
        s.normal = n > 1e-3 ? (d - raw * (dot(raw, d) / (n * n))) / n : d * 1e3;
    }
    vec3 away = s.mean - camera.position;
    s.inverse_range = inversesqrt(max(dot(away, away), 1e-30));
    s.direction = away * s.inverse_range;
    s.gradient = project_gradient(camera, p, s.mean, s.log_scale, moments, depth);
    s.statistic = STATISTIC_FLOATS > 0u ? screen_gradient(p, statistic.x, statistic.y) : s.gradient.mean2d;
    return s;
}

// Adds the mean's gradient through the color's view dependence; `s_dot[k]` = coefficient k . d/d(color).
vec3 direction_to_mean(Visible s, uint degree, float s_dot[16]) {
    vec3 d = sh_direction_gradient(s.direction, degree, s_dot);
    return (d - s.direction * dot(d, s.direction)) * s.inverse_range;
}

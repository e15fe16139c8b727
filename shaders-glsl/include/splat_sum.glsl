// Shared part of the kernels of project_bwd: sums one visible splat's gradients over its entries in order and takes them
// back through projection. Included after the buffers and constants that it names are declared.

struct Visible {
    uint gaussian;
    uint at;             // its column 0
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

Visible visible_splat(uint v) {
    Camera camera = params.step.camera;
    Visible s;
    s.gaussian = splat_ids[v];
    float moments[6];
    float colors[CHANNELS];
    [[unroll]] for (uint j = 0u; j < 6u; ++j) moments[j] = 0.0;
    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) colors[c] = 0.0;
    s.weight = 0.0;
    vec2 statistic = vec2(0.0);
    uint first = entry_starts[v], last = first + tile_counts[v];
    // Where entries' gradients have been added up already, each splat has one.
    uint from = REDUCED ? v : first, to = REDUCED ? v + 1u : last;
    for (uint e = from; e < to; ++e) {
        uint at = e * (6u + CHANNELS + WEIGHTS + STATISTIC_FLOATS);
        [[unroll]] for (uint j = 0u; j < 6u; ++j) moments[j] += entry_gradients[at + j];
        [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) colors[c] += entry_gradients[at + 6u + c];
        if (WEIGHTS > 0u) s.weight += entry_gradients[at + 6u + CHANNELS];
        if (STATISTIC_FLOATS > 0u) {
            uint from_statistic = at + 6u + CHANNELS + WEIGHTS;
            statistic += vec2(entry_gradients[from_statistic], entry_gradients[from_statistic + 1u]);
        }
    }
    // Moments that came through features; the features' own gradients are summed elsewhere (features_bwd).
    if (FEATURES > 0u) {
        for (uint e = first; e < last; ++e) {
            if (entry_flags[e] == 0u) continue;
            [[unroll]] for (uint j = 0u; j < 6u; ++j) moments[j] += entry_features[e * (6u + FEATURES) + j];
        }
    }
    uint any_gradient = 0u;
    [[unroll]] for (uint j = 0u; j < 6u; ++j) any_gradient |= magnitude_bits(moments[j]);
    [[unroll]] for (uint c = 0u; c < CHANNELS; ++c) any_gradient |= magnitude_bits(colors[c]);
    s.touched = any_gradient != 0u;
    s.at = first_column(s.gaussian);
    vec4 place = parameters[s.at];
    s.mean = place.xyz;
    s.opacity_logit = place.w;
    s.log_scale = parameters[s.at + BLOCK].xyz;
    s.rotation = parameters[s.at + 2u * BLOCK];
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
        vec3 raw = parameters[s.at + (COLUMNS - 1u) * BLOCK].xyz;
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

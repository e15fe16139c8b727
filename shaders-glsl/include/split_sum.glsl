// Reflectance of a surface under uniform light, from the split-sum table. Needs a buffer `split_sum`.

const float SPLIT_SUM_NODES = 64.0; // along a side
const float SPLIT_SUM_NV_MIN = 1e-4;

// Factor of F0 and the bias, and their derivatives by roughness. Rows are roughness, columns n.v.
vec2 split_sum_at(float roughness, float nv, out vec2 slope) {
    const float last = SPLIT_SUM_NODES - 1.0;
    vec2 x = clamp(vec2(nv, roughness), 0.0, 1.0) * last;
    vec2 low = min(floor(x), vec2(last - 1.0)), t = x - low;
    uint at = uint(low.y) * uint(SPLIT_SUM_NODES) + uint(low.x);
    vec2 upper = mix(split_sum[at], split_sum[at + 1u], t.x);
    at += uint(SPLIT_SUM_NODES);
    vec2 lower = mix(split_sum[at], split_sum[at + 1u], t.x);
    slope = roughness > 0.0 && roughness < 1.0 ? last * (lower - upper) : vec2(0.0);
    return mix(upper, lower, t.y);
}

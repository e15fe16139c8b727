// Transmittance of the Gaussians between two points.
//
// It is the product of 1 - alpha over the Gaussians whose density peaks between the points, alpha at the peak, each over
// its value at the first point. A product needs no order. Gaussians around the first point, such as its own surface,
// occlude only as far as their density rises along the ray.
//
// Traverses a compressed wide BVH (Ylitie et al. 2017) as `TracedTree` lays it out: nodes of 20 words, eight children each
// with a box of bytes. A subgroup traverses it together, visiting each node that one of its rays hits: rays of neighboring
// pixels to one light differ little, and nodes and Gaussians are fetched once for all. A ray stops once its transmittance
// is below 1e-4. Needs a constant SUBGROUP and the buffers `tree_nodes` and `tree_splats`.

const uint TRACED_STACK = 32u;
const float TRACED_ALPHA_MIN = 1.0 / 255.0;
const float TRACED_ALPHA_MAX = 0.99;

IN(uint, tree_nodes);
IN(float, tree_splats); // 13 of a Gaussian, in the order of the tree's leaves

// What all lanes want to see of `count` numbers from `at` on: on narrow subgroups, whose loads go lane by lane, the lanes
// fetch for one another.
#define TRACED_FETCH(T, count, into, buffer, at)                                                                \
    if (SUBGROUP >= 32u) {                                                                                     \
        [[unroll]] for (uint k_ = 0u; k_ < count; k_++) into[k_] = buffer[(at) + k_];                          \
    } else {                                                                                                   \
        [[unroll]] for (uint k_ = 0u; k_ < count; k_ += 8u) {                                                  \
            T mine_ = buffer[(at) + min(k_ + (gl_SubgroupInvocationID & 7u), count - 1u)];                     \
            [[unroll]] for (uint j_ = 0u; j_ < 8u; j_++) {                                                     \
                if (k_ + j_ < count) into[(k_ + j_) % count] = subgroupBroadcast(mine_, j_);                   \
            }                                                                                                  \
        }                                                                                                      \
    }

// A stack that is the same for all lanes. On wide subgroups the lanes hold an entry each, or two, because registers cannot be
// indexed: a private array would take 64 of them. On CPUs such an array is faster.
const bool STACK_IN_LANES = SUBGROUP >= 16u;
const uint STACK_HELD = SUBGROUP < TRACED_STACK ? TRACED_STACK / SUBGROUP : 1u; // entries of a lane, if lanes hold them
uvec2 traced_stack[STACK_IN_LANES ? STACK_HELD : TRACED_STACK];

void traced_push(uint at, uvec2 entry) {
    if (STACK_IN_LANES) {
        bool own = gl_SubgroupInvocationID == at % SUBGROUP;
        [[unroll]] for (uint h = 0u; h < STACK_HELD; h++) {
            if (own && at / SUBGROUP == h) traced_stack[h] = entry;
        }
    } else {
        traced_stack[at] = entry;
    }
}

uvec2 traced_pop(uint at) {
    if (!STACK_IN_LANES) return traced_stack[at];
    uvec2 own = traced_stack[0];
    [[unroll]] for (uint h = 1u; h < STACK_HELD; h++) own = at / SUBGROUP == h ? traced_stack[h] : own;
    return uvec2(subgroupShuffle(own.x, at % SUBGROUP), subgroupShuffle(own.y, at % SUBGROUP));
}

// The factor of one Gaussian: rows of the matrix that makes it a unit sphere, mean, opacity.
float traced_factor(float s[13], vec3 from, vec3 along, float reach) {
    vec3 white0 = vec3(s[0], s[1], s[2]), white1 = vec3(s[3], s[4], s[5]), white2 = vec3(s[6], s[7], s[8]);
    vec3 to = vec3(s[9], s[10], s[11]) - from;
    // From the ray's point nearest to the mean, so that little is lost where Gaussians are small and far.
    float near = dot(to, along);
    vec3 c = near * along - to;
    vec3 p = vec3(dot(white0, c), dot(white1, c), dot(white2, c));
    vec3 d = vec3(dot(white0, along), dot(white1, along), dot(white2, along));
    float inverse = 1.0 / dot(d, d);
    float t = -dot(p, d) * inverse;
    // The distance squared of the ray from the center as |p x d|² / |d|²: in p + t d what is left across a sheet thinner than a micrometer
    // would be rounding.
    vec3 r = cross(p, d), r0 = p - near * d;
    float alpha = min(s[12] * exp(-0.5 * inverse * dot(r, r)), TRACED_ALPHA_MAX);
    float before = min(s[12] * exp(-0.5 * dot(r0, r0)), TRACED_ALPHA_MAX);
    if (!(before >= TRACED_ALPHA_MIN)) before = 0.0;
    float peak = near + t;
    bool met = alpha >= TRACED_ALPHA_MIN && peak > 0.0 && peak < reach;
    return met ? min((1.0 - alpha) / (1.0 - before), 1.0) : 1.0;
}

float traced_byte(uint low, uint high, uint child) {
    return float(bitfieldExtract(child < 4u ? low : high, int(8u * (child & 3u)), 8));
}

// `along`: unit. From `from` as far as `reach`; a negative reach is no ray. All lanes of a subgroup call it together.
float traced_transmittance(vec3 from, vec3 along, float reach) {
    float left = 1.0;
    // Children of a node that are still to be visited: the first one's number, which of them, which are nodes at all. The
    // same for all lanes.
    uvec2 group = uvec2(0u, 1u);
    uint depth = 0u;
    vec3 inverse = 1.0 / mix(along, vec3(1e-20), lessThan(abs(along), vec3(1e-20)));
    while (((group.y & 0xffu) != 0u || depth > 0u) && subgroupAny(reach >= 0.0)) {
        if ((group.y & 0xffu) == 0u) group = traced_pop(--depth);
        uint slot = uint(findLSB(group.y & 0xffu));
        group.y &= ~(1u << slot);
        uint node = 20u * (group.x + bitCount((group.y >> 8u) & ((1u << slot) - 1u)));
        if ((group.y & 0xffu) != 0u && depth < TRACED_STACK) traced_push(depth++, group);

        uint w[20];
        TRACED_FETCH(uint, 20u, w, tree_nodes, node)
        vec3 corner = vec3(uintBitsToFloat(w[0]), uintBitsToFloat(w[1]), uintBitsToFloat(w[2]));
        vec3 unit = vec3(uintBitsToFloat((w[3] & 0xffu) << 23u), uintBitsToFloat((w[3] >> 8u & 0xffu) << 23u),
                         uintBitsToFloat((w[3] >> 16u & 0xffu) << 23u));
        uint inner = w[3] >> 24u;
        vec3 scale = unit * inverse, offset = (corner - from) * inverse;
        // Nodes in the upper eight bits, Gaussians of leaves in the others.
        uint hits = 0u;
        [[unroll]] for (uint child = 0u; child < 8u; child++) {
            vec3 a = vec3(traced_byte(w[8], w[9], child), traced_byte(w[12], w[13], child),
                          traced_byte(w[16], w[17], child)) * scale + offset;
            vec3 b = vec3(traced_byte(w[10], w[11], child), traced_byte(w[14], w[15], child),
                          traced_byte(w[18], w[19], child)) * scale + offset;
            vec3 low = min(a, b), high = max(a, b);
            float begin = max(max(low.x, low.y), max(low.z, 0.0)), end = min(min(high.x, high.y), min(high.z, reach));
            // A leaf has up to three Gaussians, as many bits in the upper three, from the one in the lower five; a node's
            // number there is 24 and its place.
            uint about = bitfieldExtract(child < 4u ? w[6] : w[7], int(8u * (child & 3u)), 8);
            if (begin <= end) hits |= about >> 5u << (about & 31u);
        }
        hits = subgroupOr(hits);
        group = uvec2(w[4], hits >> 24u | inner << 8u);
        hits &= 0xffffffu;
        while (hits != 0u) {
            uint i = uint(findLSB(hits));
            hits &= hits - 1u;
            float s[13];
            TRACED_FETCH(float, 13u, s, tree_splats, 13u * (w[5] + i))
            left *= traced_factor(s, from, along, reach);
        }
        if (left < 1e-4) reach = -1.0;
    }
    return left;
}

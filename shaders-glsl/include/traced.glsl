// How much light gets through the Gaussians between two points: the product of 1 - alpha over those whose density peaks
// between them, alpha at the peak, each over what it is at the first point. A product needs no order; and what lies around
// the first point, such as the surface it is on, hides only as much as it becomes denser along the ray.
//
// Through a compressed wide BVH (Ylitie et al. 2017) as `TracedTree` lays it out: nodes of 20 words, eight children each
// with a box of bytes. Where less than 1e-4 is left, the rest is not looked for. Needs the buffers `tree_nodes` and
// `tree_splats`.

const uint TRACED_STACK = 32u;
const float TRACED_ALPHA_MIN = 1.0 / 255.0;
const float TRACED_ALPHA_MAX = 0.99;

// A Gaussian as rays see it.
struct TracedSplat {
    vec3 white0; // rows of the matrix that makes it a unit sphere
    vec3 white1;
    vec3 white2;
    vec3 mean;
    float opacity;
};

IN(uint, tree_nodes);
IN(TracedSplat, tree_splats); // in the order of the tree's leaves; without Gaussians one that is never looked at

// The factor of one Gaussian.
float traced_factor(TracedSplat s, vec3 from, vec3 along, float reach) {
    vec3 to = s.mean - from;
    // From the ray's point nearest to the mean, so that little is lost where Gaussians are small and far.
    float near = dot(to, along);
    vec3 c = near * along - to;
    vec3 p = vec3(dot(s.white0, c), dot(s.white1, c), dot(s.white2, c));
    vec3 d = vec3(dot(s.white0, along), dot(s.white1, along), dot(s.white2, along));
    float t = -dot(p, d) / dot(d, d);
    vec3 r = p + t * d;
    float alpha = min(s.opacity * exp(-0.5 * dot(r, r)), TRACED_ALPHA_MAX);
    float peak = near + t;
    if (!(alpha >= TRACED_ALPHA_MIN && peak > 0.0 && peak < reach)) return 1.0;
    vec3 r0 = p - near * d;
    float before = min(s.opacity * exp(-0.5 * dot(r0, r0)), TRACED_ALPHA_MAX);
    return before >= TRACED_ALPHA_MIN ? min((1.0 - alpha) / (1.0 - before), 1.0) : 1.0 - alpha;
}

float traced_byte(uint low, uint high, uint child) {
    return float(bitfieldExtract(child < 4u ? low : high, int(8u * (child & 3u)), 8));
}

// `along`: unit. From `from` as far as `reach`.
float traced_transmittance(vec3 from, vec3 along, float reach) {
    float left = 1.0;
    // Children of a node that are still to be visited: the first one's number, which of them, which are nodes at all.
    uvec2 group = uvec2(0u, 1u), stack[TRACED_STACK];
    uint depth = 0u;
    vec3 inverse = 1.0 / mix(along, vec3(1e-20), lessThan(abs(along), vec3(1e-20)));
    while (left >= 1e-4 && ((group.y & 0xffu) != 0u || depth > 0u)) {
        if ((group.y & 0xffu) == 0u) group = stack[--depth];
        uint slot = uint(findLSB(group.y & 0xffu));
        group.y &= ~(1u << slot);
        uint node = 20u * (group.x + bitCount((group.y >> 8u) & ((1u << slot) - 1u)));
        if ((group.y & 0xffu) != 0u && depth < TRACED_STACK) stack[depth++] = group;

        uint packed = tree_nodes[node + 3u];
        vec3 corner = vec3(uintBitsToFloat(tree_nodes[node]), uintBitsToFloat(tree_nodes[node + 1u]),
                           uintBitsToFloat(tree_nodes[node + 2u]));
        vec3 unit = vec3(uintBitsToFloat((packed & 0xffu) << 23u), uintBitsToFloat((packed >> 8u & 0xffu) << 23u),
                         uintBitsToFloat((packed >> 16u & 0xffu) << 23u));
        uint inner = packed >> 24u, first = tree_nodes[node + 5u];
        uvec2 meta = uvec2(tree_nodes[node + 6u], tree_nodes[node + 7u]);
        uvec2 box[6]; // least and most x, y, z of eight children
        [[unroll]] for (uint k = 0u; k < 6u; k++) {
            box[k] = uvec2(tree_nodes[node + 8u + 2u * k], tree_nodes[node + 9u + 2u * k]);
        }
        vec3 scale = unit * inverse, offset = (corner - from) * inverse;
        uint hits = 0u, leaves = 0u;
        [[unroll]] for (uint child = 0u; child < 8u; child++) {
            vec3 a = vec3(traced_byte(box[0].x, box[0].y, child), traced_byte(box[2].x, box[2].y, child),
                          traced_byte(box[4].x, box[4].y, child)) * scale + offset;
            vec3 b = vec3(traced_byte(box[1].x, box[1].y, child), traced_byte(box[3].x, box[3].y, child),
                          traced_byte(box[5].x, box[5].y, child)) * scale + offset;
            vec3 low = min(a, b), high = max(a, b);
            float begin = max(max(low.x, low.y), max(low.z, 0.0)), end = min(min(high.x, high.y), min(high.z, reach));
            uint about = uint(traced_byte(meta.x, meta.y, child));
            if (begin <= end) {
                // A leaf has up to three Gaussians, as many bits in the upper three, from the one in the lower five.
                if ((inner >> child & 1u) != 0u) hits |= 1u << child;
                else leaves |= about >> 5u << (about & 31u);
            }
        }
        group = uvec2(tree_nodes[node + 4u], hits | inner << 8u);
        while (leaves != 0u) {
            uint i = uint(findLSB(leaves));
            leaves &= leaves - 1u;
            left *= traced_factor(tree_splats[first + i], from, along, reach);
        }
    }
    return left;
}

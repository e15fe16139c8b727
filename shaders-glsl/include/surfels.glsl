// Rays against surfels: one-sided discs in a compressed wide BVH (Ylitie et al. 2017), as `SurfelTree` lays it out.
//
// A ray meets a disc on its front, where dot(normal, along) < 0, and passes through its back. Rays of neighboring
// invocations diverge, so each invocation traverses the tree alone, nearest octant first. Results do not depend on the
// tree: of discs at equal distance, the lowest index counts. Needs `common.glsl`.
//
// With SURFEL_VALUES, the including kernel defines `vec4 surfel_value(SurfelDisc disc, float at, float beside)`, which
// `surfel_sum` adds over all discs of a part of a ray.

const uint SURFEL_STACK = 32u; // levels, checked by the host
const uint SURFEL_NONE = 0xffffffffu;
// What a traversal returns: the first disc, any disc, or the sum over all of them.
const uint SURFEL_FIRST = 0u, SURFEL_ANY = 1u, SURFEL_ALL = 2u;

// A disc in the order of the tree's leaves.
struct SurfelDisc {
    vec3 point;
    float radius;
    vec3 normal;
    uint index; // in the caller's order
};

struct SurfelNode {
    uvec4 words[5];
};

IN(SurfelNode, surfel_nodes);
IN(SurfelDisc, surfel_discs);

#ifdef SURFEL_VALUES
// `at`: distance along the ray. `beside`: square of the distance from the center over that of the radius.
vec4 surfel_value(SurfelDisc disc, float at, float beside);
#endif

// Distance at which a ray meets a disc, or -1.
float surfel_distance(SurfelDisc disc, vec3 from, vec3 along) {
    vec3 to = disc.point - from;
    float facing = dot(disc.normal, along), at = dot(disc.normal, to) / facing;
    vec3 beside = at * along - to;
    return facing < 0.0 && at > 0.0 && dot(beside, beside) <= disc.radius * disc.radius ? at : -1.0;
}

vec3 surfel_bytes(uvec3 words, int child) {
    return vec3(bitfieldExtract(words.x, 8 * child, 8), bitfieldExtract(words.y, 8 * child, 8),
                bitfieldExtract(words.z, 8 * child, 8));
}

// Children of a node that a ray meets between two distances: nodes in the upper eight bits, nearest octant highest; discs
// of leaves in the others.
uint surfel_children(SurfelNode node, vec3 from, vec3 inverse, uint octant, float least, float reach) {
    uvec4 w0 = node.words[0], w1 = node.words[1], w2 = node.words[2], w3 = node.words[3], w4 = node.words[4];
    vec3 corner = uintBitsToFloat(w0.xyz);
    vec3 unit = uintBitsToFloat(uvec3(w0.w & 0xffu, w0.w >> 8u & 0xffu, w0.w >> 16u & 0xffu) << 23u);
    vec3 scale = unit * inverse, offset = (corner - from) * inverse;
    uint hits = 0u;
    [[unroll]] for (int child = 0; child < 8; child++) {
        bool upper = child >= 4;
        int at = child & 3;
        vec3 a = surfel_bytes(upper ? uvec3(w2.y, w3.y, w4.y) : uvec3(w2.x, w3.x, w4.x), at) * scale + offset;
        vec3 b = surfel_bytes(upper ? uvec3(w2.w, w3.w, w4.w) : uvec3(w2.z, w3.z, w4.z), at) * scale + offset;
        vec3 low = min(a, b), high = max(a, b);
        float begin = max(max(low.x, low.y), max(low.z, least)), end = min(min(high.x, high.y), min(high.z, reach));
        // A leaf has up to three discs, as many bits in the upper three, from the one in the lower five. A node's number
        // there is 24 and its place.
        uint about = bitfieldExtract(upper ? w1.w : w1.z, 8 * at, 8), place = about & 31u;
        // Rounding of the slabs may not lose a disc; boxes have a margin for that of their corners.
        if (begin <= end * 1.000002) hits |= about >> 5u << (place >= 24u ? place ^ octant : place);
    }
    return hits;
}

// `along`: unit. Index of the disc that the ray meets first before `reach`, which becomes its distance; or SURFEL_NONE.
// With SURFEL_ANY, of some disc. With SURFEL_ALL, the values of the discs from `least` to `reach` are added to `sum`. A
// negative reach is no ray.
uint surfel_trace(vec3 from, vec3 along, float least, inout float reach, const uint what, inout vec4 sum) {
    uint found = SURFEL_NONE;
    vec3 inverse = 1.0 / mix(along, vec3(1e-20), lessThan(abs(along), vec3(1e-20)));
    uint octant = (along.x < 0.0 ? 0u : 4u) | (along.y < 0.0 ? 0u : 2u) | (along.z < 0.0 ? 0u : 1u);
    // Children of a node that are still to be visited: number of the first node, the nodes in the upper eight bits, and
    // which children are nodes in the lower ones.
    uvec2 group = uvec2(0u, reach >= 0.0 ? 0x80000000u : 0u), stack[SURFEL_STACK];
    bool root = true;
    uint depth = 0u;
    while (group.y > 0xffffffu || depth > 0u) {
        if (group.y <= 0xffffffu) group = stack[--depth];
        uint bit = uint(findMSB(group.y)), slot = (bit - 24u) ^ octant;
        group.y &= ~(1u << bit);
        uint at = root ? 0u : group.x + bitCount(group.y & 0xffu & ((1u << slot) - 1u));
        root = false;
        if (group.y > 0xffffffu && depth < SURFEL_STACK) stack[depth++] = group;

        SurfelNode node = surfel_nodes[at];
        uint hits = surfel_children(node, from, inverse, octant, least, reach);
        group = uvec2(node.words[1].x, (hits & 0xff000000u) | node.words[0].w >> 24u);
        hits &= 0xffffffu;
        while (hits != 0u) {
            SurfelDisc disc = surfel_discs[node.words[1].y + uint(findLSB(hits))];
            hits &= hits - 1u;
            float distance = surfel_distance(disc, from, along);
#ifdef SURFEL_VALUES
            if (what == SURFEL_ALL) {
                vec3 beside = distance * along - (disc.point - from);
                float square = dot(beside, beside) / (disc.radius * disc.radius);
                if (distance > 0.0 && distance >= least && distance <= reach) sum += surfel_value(disc, distance, square);
                continue;
            }
#endif
            if (distance > 0.0 && (distance < reach || distance == reach && found != SURFEL_NONE && disc.index < found)) {
                if (what == SURFEL_ANY) return disc.index;
                found = disc.index;
                reach = distance;
            }
        }
    }
    return found;
}

// Index of the disc, in the caller's order, that the ray meets first before `reach`; SURFEL_NONE if there is none.
uint surfel_closest(vec3 from, vec3 along, float reach) {
    vec4 none = vec4(0.0);
    return surfel_trace(from, along, 0.0, reach, SURFEL_FIRST, none);
}

// Whether the ray meets a disc before `reach`.
bool surfel_hidden(vec3 from, vec3 along, float reach) {
    vec4 none = vec4(0.0);
    return surfel_trace(from, along, 0.0, reach, SURFEL_ANY, none) != SURFEL_NONE;
}

// As surfel_closest without an end. `at` becomes the distance of the disc.
uint surfel_first(vec3 from, vec3 along, out float at) {
    vec4 none = vec4(0.0);
    at = uintBitsToFloat(0x7f7fffffu);
    return surfel_trace(from, along, 0.0, at, SURFEL_FIRST, none);
}

#ifdef SURFEL_VALUES
// Sum of the values of the discs that the ray meets from distance `least` to `reach`, in an order that the tree decides.
vec4 surfel_sum(vec3 from, vec3 along, float least, float reach) {
    vec4 sum = vec4(0.0);
    surfel_trace(from, along, least, reach, SURFEL_ALL, sum);
    return sum;
}
#endif

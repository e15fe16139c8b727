// Backward of the visibility field, first half: from the gradient of each pair of pixel and light to the weights of all
// layers but the first one's features, to the lights' positions, and to the rows of points.
//
// Recomputes the forward pass of each pair. A lane holds a pixel and visits its lights. Layers are visibility_bwd_pairs.glsl's,
// or visibility_bwd_matrices.glsl's where MATRIX_UNITS is defined. Weights are loads from addresses that all lanes share; see
// visibility_weights.glsl. Rows of points are summed over the lights first, so that the second half runs once a pixel. A
// workgroup is one subgroup and writes one set of sums.
//
// Small views have fewer batches of pixels than a device runs subgroups. There PARTS workgroups share a batch: each takes
// every PARTS-th of its lights, and writes rows of its own.
//
// Needs visibility_grid.glsl, random.glsl and visibility_jitter.glsl, the constants and buffers below, and functions:
//     void pair_begin(uint pixel, bool is_shaded)  before the first light of a pixel, which may be any if it is not shaded
//     bool pair_matters(uint light)                cheap: whether the next one can be other than zero
//     float pair_gradient(uint light)              derivative of the loss by the visibility of the light
// All invocations of a subgroup call them together. Lights are light_of(0) to light_of(light_count() - 1), and
// light_place(light) is the position of a light in the world. Lights differ between groups of GROUP lanes.

#define ITEM_COUNT 4
#include "visibility_lanes.glsl"

const uint INPUTS = 2u * LEVELS + 4u;
const uint SECOND = WIDTH * INPUTS;
const uint LAST = SECOND + WIDTH * WIDTH;

// Sums of a workgroup: second layer by output and input; first layer's direction and distance by neuron; last layer.
const uint SUMS = WIDTH * WIDTH + 4u * WIDTH + WIDTH;

const uint BLOCKS = WIDTH / 4u;                   // of four neurons
const uint GROUP = SAMPLE > 1u ? 8u : SUBGROUP;   // pixels that visit the same lights; sampled() decides for eight
const uint GROUPS = SUBGROUP / GROUP;

#include "visibility_weights.glsl"

#define EACH(i, count) [[unroll]] for (uint i = 0u; i < count; i++)

// Weights of the second layer by output and block of inputs, of the first layer's direction and distance, and of a block of
// the last layer.
vec4 second_from(uint i) { return mlp_vectors[SECOND / 4u + i]; }
vec4 pair_from(uint n) { return weights_from(n * INPUTS + 2u * LEVELS); }
vec4 last_from(uint b) { return mlp_vectors[LAST / 4u + b]; }

// What other lanes of the subgroup, which is the workgroup, have written to shared memory.
void exchange() {
    subgroupMemoryBarrierShared();
    subgroupBarrier();
}

bool lane_shaded;
uint row_at;       // first number of the pixel's row, whose numbers are SUBGROUP apart
vec4 way;          // of the pair
uint alive;        // bits of the first layer's neurons that are above zero
float logit;
vec4 turn;         // derivative by the way
vec4 by_row[BLOCKS]; // of this pixel, by neuron

// A neuron of the first layer.
float first_layer(vec4 w, vec4 way, float row) {
    return rectified(fma(w.x, way.x, fma(w.y, way.y, fma(w.z, way.z, fma(w.w, way.w, row)))));
}

float row_of(uint n, bool moved) {
    if (!lane_shaded) return 0.0;
    return REGULARIZED && moved ? moved_rows[row_at + n * SUBGROUP] : rows[row_at + n * SUBGROUP];
}

// The layers of a pair. Define:
//     LAYER_SUMS  declares sums that main() keeps, and clears all sums
//     void layers_begin()
//     float evaluate(FieldStep field, vec3 moved_point, vec3 point, uint light, vec3 place)  sets `way`, `alive` and
//         `logit` of the pair, and returns the logit of the jittered one
//     BACK(slope)  from the derivative of the loss by the logit to `turn`, `by_row` and sums
//     WRITE_SUMS  of the workgroup to sums_of
#ifdef MATRIX_UNITS
#include "visibility_bwd_matrices.glsl"
#else
#include "visibility_bwd_pairs.glsl"
#endif

// 1 for each pair that counts; with SAMPLE above 1 these are so many times fewer, and count for as much more.
bool sampled(uint pixel, uint light) {
    return SAMPLE <= 1u || random_bits(field_params.field.seed ^ 0x3c6eu, pixel / 8u, light) % SAMPLE == 0u;
}

// Whether any lane of this lane's group says so.
bool any_of_group(bool x) {
    if (GROUPS == 1u) return subgroupAny(x);
    uvec4 votes = subgroupBallot(x);
    uint lane = gl_SubgroupInvocationID;
    return ((votes[lane / 32u] >> (lane % 32u / 8u * 8u)) & 0xffu) != 0u;
}

// Adds a vector over the lanes of each group: lane c then has component c % 4.
float group_sum(vec3 v) {
    float sums[4] = float[4](v.x, v.y, v.z, 0.0);
    ITEM_SUMS_AT(sums, 2u)
    ITEM_SUMS_AT(sums, 1u)
    [[unroll]] for (uint reach = 4u; reach < GROUP; reach *= 2u) sums[0] += subgroupShuffleXor(sums[0], reach);
    return sums[0];
}

// Moving the light moves direction and distance the other way; at the faces, or in the point, nothing. The component across
// the ray, by vector products: a difference would leave a ten-millionth of the component along it.
vec3 place_gradient(FieldStep field, vec3 place) {
    vec3 across = cross(way.xyz, cross(turn.xyz, way.xyz));
    vec3 gradient = across / max(way.w, 1e-12) + way.xyz * turn.w;
    uvec3 inside = uvec3(greaterThan(place, field.box_min)) * uvec3(lessThan(place, field.box_max));
    return mix(vec3(0.0), -gradient * field.box_inverse, bvec3(inside * uint(way.w > 1e-12)));
}

void main() {
    LAYER_SUMS
    layers_begin();
    FieldStep field = field_params.field;
    uint lights = light_count();
    float largest = 0.0, jitter = 0.0;
    uint items = (push.count + SUBGROUP - 1u) / SUBGROUP * PARTS;
    [[dont_unroll]] for (uint item = gl_WorkGroupID.x; item < items; item += gl_NumWorkGroups.x) {
        uint batch = item / PARTS, part = item % PARTS;
        uint local = batch * SUBGROUP + gl_SubgroupInvocationID, pixel = push.first + local;
        bool exists = local < push.count && pixel < field.pixels;
        uint at = exists ? pixel : 0u;
        lane_shaded = exists && is_covered(coverage[at]);
        vec3 point = lane_shaded ? points[at] : field.box_min, moved_point = point;
        if (REGULARIZED) moved_point = field_inside(field, point + jitter_of(field, POINTS, at));
        point = field_inside(field, point);
        row_at = batch * SUBGROUP * WIDTH + gl_SubgroupInvocationID;
        EACH(b, BLOCKS) by_row[b] = vec4(0.0);
        pair_begin(at, lane_shaded);
        uint next = part;
        [[dont_unroll]] for (;;) {
            // To the next light that matters to any pixel of the group. Groups that have found one wait for the others.
            uint light = 0u;
            bool found = false;
            [[dont_unroll]] for (;;) {
                bool is_open = !found && next < lights;
                if (!subgroupAny(is_open)) break;
                uint candidate = min(light_of(min(next, lights - 1u)), push.most - 1u);
                bool takes = is_open && lane_shaded && sampled(pixel, candidate);
                if (any_of_group(takes && (REGULARIZED || pair_matters(candidate)))) {
                    found = true;
                    light = candidate;
                }
                next += is_open ? PARTS : 0u;
            }
            if (!subgroupAny(found)) break;
            bool counts = found && lane_shaded && sampled(pixel, light);
            vec3 place = light_place(light);
            float by_visibility = pair_gradient(light);
            float moved_logit = evaluate(field, moved_point, point, light, place);
            // The squashing function's order is that of the logits.
            if (REGULARIZED) {
                by_visibility += field.regularizer * sign(logit - moved_logit);
                float apart = abs(1.0 / (1.0 + exp(-logit)) - 1.0 / (1.0 + exp(-moved_logit)));
                if (counts && finite_bits(apart)) jitter += float(max(SAMPLE, 1u)) * field.regularizer * apart;
            }
            float e = exp(-abs(logit)), d = 1.0 / (1.0 + e);
            float slope = counts ? float(max(SAMPLE, 1u)) * by_visibility * (e * d * d) : 0.0;
            if (!finite_bits(slope)) slope = 0.0;
            BACK(slope)
            if (PLACES) {
                float sum = group_sum(place_gradient(field, place));
                uint place_row = gl_WorkGroupID.x * GROUPS + gl_SubgroupInvocationID / GROUP;
                uint axis = gl_SubgroupInvocationID % GROUP;
                if (found && axis < 3u) place_sums[(place_row * push.most + light) * 3u + axis] += sum;
            }
        }
        EACH(b, BLOCKS) {
            EACH(j, 4u) {
                if (!finite_bits(by_row[b][j])) by_row[b][j] = 0.0;
                largest = max(largest, abs(by_row[b][j]));
            }
            if (local < push.count) {
                EACH(j, 4u) row_gradients[(part * push.count + local) * WIDTH + 4u * b + j] = by_row[b][j];
            }
        }
    }
    if (REGULARIZED) {
        [[unroll]] for (uint reach = 1u; reach < SUBGROUP; reach *= 2u) jitter += subgroupShuffleXor(jitter, reach);
        if (gl_SubgroupInvocationID == 0u) jitter_sums[gl_WorkGroupID.x] += jitter;
    }
    largest = subgroupMax(largest);
    if (subgroupElect()) {
        uint at = gl_NumWorkGroups.x + gl_WorkGroupID.x;
        jitter_sums[at] = max(jitter_sums[at], largest);
    }
    WRITE_SUMS
}

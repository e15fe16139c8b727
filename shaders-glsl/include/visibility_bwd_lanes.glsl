// Backward of the visibility field, first half: from the gradient of each pair of pixel and light to the weights of all
// layers but the first one's features, to the lights' positions, and to the rows of points. For CPUs; elsewhere the pass runs
// visibility_bwd.glsl, which needs the same.
//
// Recomputes the forward pass of each pair. Its share of the second layer's gradient is an outer product, so lanes hold the
// sums by neuron; see visibility_lanes.glsl. Processes four pixels and one light at a time (with eight, compilers take three
// times as long). A workgroup is one subgroup and writes one set of sums. Rows of points are summed over the lights first,
// so that the second half runs once a pixel.
//
// Needs visibility_grid.glsl, random.glsl and visibility_jitter.glsl, the constants and buffers below, and functions:
//     void pair_begin(uint pixel, bool is_shaded)  before the first light of a pixel, which may be any if it is not shaded
//     bool pair_matters(uint light)                cheap: whether the next one can be other than zero
//     float pair_gradient(uint light)              derivative of the loss by the visibility of the light
// All invocations of a subgroup call them together. Lights are light_of(0) to light_of(light_count() - 1), and
// light_place(light) is the position of a light in the world.

#define ITEM_COUNT 4
#include "visibility_lanes.glsl"

const uint INPUTS = 2u * LEVELS + 4u;
const uint SECOND = WIDTH * INPUTS;
const uint LAST = SECOND + WIDTH * WIDTH;
const uint NEVER = 0xffffffffu;

// Sums of a workgroup: second layer by output and input; first layer's direction and distance by neuron; last layer.
const uint SUMS = WIDTH * WIDTH + 4u * WIDTH + WIDTH;

float first_pair[4u * HELD]; // of the first layer: direction, distance
float columns[WIDTH * HELD]; // of the second layer
float rows_of[WIDTH * HELD]; // its rows
float last[HELD];

IN(float, mlp);

float pair_column(uint k, uint h) { return mlp[neuron(h) * INPUTS + 2u * LEVELS + k]; }
float second_column(uint k, uint h) { return mlp[SECOND + neuron(h) * WIDTH + k]; }
float second_row(uint o, uint h) { return mlp[SECOND + o * WIDTH + neuron(h)]; }
float last_column(uint k, uint h) { return mlp[LAST + neuron(h)]; }

vec4 way;                      // of this lane's item: direction from the light, distance
float here[ITEMS * HELD];      // rows of points
float moved[ITEMS * HELD];     // rows of points moved
float hidden[ITEMS * HELD];    // after the first layer
float second[ITEMS * HELD];    // after the second
float logits[ITEMS];
float slope;                   // of this lane's item: derivative by the logit

float by_second[WIDTH * HELD]; // sums
float by_pair[4u * HELD];
float by_last[HELD];
float by_row[ITEMS * HELD];    // of this batch, by item
float turn_x[ITEMS], turn_y[ITEMS], turn_z[ITEMS], stretch[ITEMS]; // derivatives by direction and distance

// Number of items that share loads of weights and sums.
const uint TOGETHER = 2u;
#define EACH_OF(i) [[unroll]] for (uint i = 0u; i < TOGETHER; i++)
#define EACH_FIRST(f) f(0u); f(2u);

bool moving;

void layers(uint first) {
    EACH_OF(i) {
        uint item = first + i;
        float x = from_lane(way.x, item), y = from_lane(way.y, item), z = from_lane(way.z, item);
        float reach = from_lane(way.w, item);
        EACH_HELD(h) {
            float row = REGULARIZED && moving ? moved[item * HELD + h] : here[item * HELD + h];
            float at = fma(first_pair[3u * HELD + h], reach, row);
            at = fma(first_pair[h], x, fma(first_pair[HELD + h], y, fma(first_pair[2u * HELD + h], z, at)));
            hidden[item * HELD + h] = rectified(at);
            second[item * HELD + h] = 0.0;
        }
    }
    [[unroll]] for (uint k = 0u; k < WIDTH; k++) {
        float a[TOGETHER];
        EACH_OF(i) a[i] = from_lane(hidden[(first + i) * HELD + k % HELD], k / HELD);
        EACH_HELD(h) {
            float w = columns[k * HELD + h];
            EACH_OF(i) second[(first + i) * HELD + h] = fma(w, a[i], second[(first + i) * HELD + h]);
        }
    }
    EACH_OF(i) {
        uint item = first + i;
        float logit = 0.0;
        EACH_HELD(h) {
            second[item * HELD + h] = rectified(second[item * HELD + h]);
            logit = fma(last[h], second[item * HELD + h], logit);
        }
        logits[item] = logit;
    }
}

void back(uint first) {
    float above[TOGETHER * HELD], below[TOGETHER * HELD];
    EACH_OF(i) {
        float by_logit = from_lane(slope, first + i);
        EACH_HELD(h) {
            float s = second[(first + i) * HELD + h];
            by_last[h] = fma(by_logit, s, by_last[h]);
            above[i * HELD + h] = s > 0.0 ? by_logit * last[h] : 0.0;
            below[i * HELD + h] = 0.0;
        }
    }
    [[unroll]] for (uint o = 0u; o < WIDTH; o++) {
        float g[TOGETHER];
        EACH_OF(i) g[i] = from_lane(above[i * HELD + o % HELD], o / HELD);
        EACH_HELD(h) {
            float w = rows_of[o * HELD + h], sum = by_second[o * HELD + h];
            EACH_OF(i) {
                below[i * HELD + h] = fma(w, g[i], below[i * HELD + h]);
                sum = fma(hidden[(first + i) * HELD + h], g[i], sum);
            }
            by_second[o * HELD + h] = sum;
        }
    }
    EACH_OF(i) {
        uint item = first + i;
        float x = from_lane(way.x, item), y = from_lane(way.y, item), z = from_lane(way.z, item);
        float reach = from_lane(way.w, item);
        turn_x[item] = turn_y[item] = turn_z[item] = stretch[item] = 0.0;
        EACH_HELD(h) {
            float g = hidden[item * HELD + h] > 0.0 ? below[i * HELD + h] : 0.0;
            by_row[item * HELD + h] += g;
            by_pair[h] = fma(g, x, by_pair[h]);
            by_pair[HELD + h] = fma(g, y, by_pair[HELD + h]);
            by_pair[2u * HELD + h] = fma(g, z, by_pair[2u * HELD + h]);
            by_pair[3u * HELD + h] = fma(g, reach, by_pair[3u * HELD + h]);
            turn_x[item] = fma(g, first_pair[h], turn_x[item]);
            turn_y[item] = fma(g, first_pair[HELD + h], turn_y[item]);
            turn_z[item] = fma(g, first_pair[2u * HELD + h], turn_z[item]);
            stretch[item] = fma(g, first_pair[3u * HELD + h], stretch[item]);
        }
    }
}

void clear_row(uint item) {
    EACH_HELD(h) by_row[item * HELD + h] = 0.0;
}

uint side_first; // first of this side's pixels in the chunk
bool lane_shaded;

void fetch_row(uint item) {
    bool is_shaded = from_lane(lane_shaded ? 1.0 : 0.0, item) > 0.0;
    uint at = min(side_first + item, push.count - 1u) * WIDTH;
    EACH_HELD(h) {
        float row = is_shaded ? rows[at + neuron(h)] : 0.0;
        here[item * HELD + h] = row;
        if (REGULARIZED) moved[item * HELD + h] = is_shaded ? moved_rows[at + neuron(h)] : 0.0;
    }
}

void write_row(uint item) {
    if (side_first + item < push.count) {
        EACH_HELD(h) row_gradients[(side_first + item) * WIDTH + neuron(h)] = by_row[item * HELD + h];
    }
}

// 1 for each pair that counts; with SAMPLE above 1 these are so many times fewer, and count for as much more.
bool sampled(uint pixel, uint light) {
    return SAMPLE <= 1u || random_bits(field_params.field.seed ^ 0x3c6eu, pixel / 8u, light) % SAMPLE == 0u;
}

void main() {
    FILL_COLUMNS(first_pair, 4u, pair_column)
    FILL_COLUMNS(columns, WIDTH, second_column)
    FILL_COLUMNS(rows_of, WIDTH, second_row)
    FILL_COLUMNS(last, 1u, last_column)
    [[unroll]] for (uint i = 0u; i < WIDTH * HELD; i++) by_second[i] = 0.0;
    EACH_HELD(h) by_last[h] = by_pair[h] = by_pair[HELD + h] = by_pair[2u * HELD + h] = by_pair[3u * HELD + h] = 0.0;
    FieldStep field = field_params.field;
    uint lights = light_count();
    uint side = gl_SubgroupInvocationID / ACROSS;
    float largest = 0.0, jitter = 0.0;
    [[dont_unroll]] for (uint batch = gl_WorkGroupID.x * SIDES; batch * ITEMS < push.count;
                         batch += gl_NumWorkGroups.x * SIDES) {
        side_first = (batch + side) * ITEMS;
        uint local = side_first + column() % ITEMS, pixel = push.first + local;
        bool exists = local < push.count && pixel < field.pixels;
        uint at = exists ? pixel : 0u;
        lane_shaded = exists && is_covered(coverage[at]);
        vec3 point = lane_shaded ? points[at] : field.box_min, moved_point = point;
        if (REGULARIZED) moved_point = field_inside(field, point + jitter_of(field, POINTS, at));
        point = field_inside(field, point);
        EACH_ITEM(fetch_row)
        EACH_ITEM(clear_row)
        pair_begin(at, lane_shaded);
        // A loop passes over lights that do not matter to any of the pixels: processors skip nothing else.
        [[dont_unroll]] for (uint next = 0u;; next++) {
            uint light = 0u;
            [[dont_unroll]] for (; next < lights; next++) {
                light = min(light_of(next), push.most - 1u);
                bool counts = lane_shaded && sampled(pixel, light) && (REGULARIZED || pair_matters(light));
                if (subgroupAny(counts)) break;
            }
            if (next >= lights) break;
            bool counts = lane_shaded && sampled(pixel, light);
            vec3 place = light_place(light);
            float by_visibility = pair_gradient(light), moved_logit = 0.0;
            // First the jittered point, then the point itself, whose state the backward pass uses.
            float logit = 0.0;
            [[dont_unroll]] for (uint turn = REGULARIZED ? 0u : 1u; turn < 2u; turn++) {
                moving = turn == 0u;
                vec3 to = moving ? place + jitter_of(field, LIGHTS, light) : place;
                way = field_way(field, moving ? moved_point : point, field_inside(field, to));
                moved_logit = logit;
                EACH_FIRST(layers)
                ITEM_SUMS(logits)
                logit = logits[0];
            }
            // The squashing function's order is that of the logits.
            if (REGULARIZED) {
                by_visibility += field.regularizer * sign(logit - moved_logit);
                float apart = abs(1.0 / (1.0 + exp(-logit)) - 1.0 / (1.0 + exp(-moved_logit)));
                if (counts && column() < ITEMS && finite_bits(apart)) {
                    jitter += float(max(SAMPLE, 1u)) * field.regularizer * apart;
                }
            }
            float e = exp(-abs(logit)), d = 1.0 / (1.0 + e);
            slope = counts ? float(max(SAMPLE, 1u)) * by_visibility * (e * d * d) : 0.0;
            if (!finite_bits(slope)) slope = 0.0;
            EACH_FIRST(back)
            if (PLACES) {
                ITEM_SUMS(turn_x)
                ITEM_SUMS(turn_y)
                ITEM_SUMS(turn_z)
                ITEM_SUMS(stretch)
                vec3 turn = vec3(turn_x[0], turn_y[0], turn_z[0]);
                // Moving the light moves direction and distance the other way; at the faces, or in the point, nothing.
                // The component across the ray, by vector products: a difference would leave a ten-millionth of the component
                // along it.
                vec3 across = cross(way.xyz, cross(turn, way.xyz));
                vec3 position_gradient = across / max(way.w, 1e-12) + way.xyz * stretch[0];
                uvec3 inside = uvec3(greaterThan(place, field.box_min)) * uvec3(lessThan(place, field.box_max));
                bool whose = column() < ITEMS && way.w > 1e-12;
                position_gradient = mix(vec3(0.0), -position_gradient * field.box_inverse, bvec3(inside * uint(whose)));
                float sums[ITEMS];
                [[unroll]] for (uint i = 0u; i < ITEMS; i++) sums[i] = i < 3u ? position_gradient[i] : 0.0;
                ITEM_SUMS(sums)
                if (column() < 3u) {
                    place_sums[((gl_WorkGroupID.x * SIDES + side) * push.most + light) * 3u + column()] += sums[0];
                }
            }
        }
        [[unroll]] for (uint i = 0u; i < ITEMS * HELD; i++) {
            if (!finite_bits(by_row[i])) by_row[i] = 0.0;
            largest = max(largest, abs(by_row[i]));
        }
        EACH_ITEM(write_row)
    }
    if (REGULARIZED) {
        float of_side = 0.0;
        [[unroll]] for (uint i = 0u; i < ITEMS; i++) of_side += from_lane(jitter, i);
        if (column() == 0u) jitter_sums[gl_WorkGroupID.x * SIDES + side] += of_side;
    }
    largest = subgroupMax(largest);
    if (subgroupElect()) {
        uint at = gl_NumWorkGroups.x * SIDES + gl_WorkGroupID.x;
        jitter_sums[at] = max(jitter_sums[at], largest);
    }
    float staged[(WIDTH + 5u) * HELD];
    [[unroll]] for (uint i = 0u; i < WIDTH * HELD; i++) staged[i] = by_second[i];
    [[unroll]] for (uint i = 0u; i < 4u * HELD; i++) staged[WIDTH * HELD + i] = by_pair[i];
    EACH_HELD(h) staged[(WIDTH + 4u) * HELD + h] = by_last[h];
    uint to = (gl_WorkGroupID.x * SIDES + side) * SUMS;
    [[dont_unroll]] for (uint i = 0u; i < (WIDTH + 5u) * HELD; i++) {
        sums_of[to + i / HELD * WIDTH + neuron(i % HELD)] = staged[i];
    }
}

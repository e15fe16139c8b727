// Layers of visibility_bwd.glsl in 32 bits.
//
// Layers need no exchange: an instruction multiplies a weight, the same for all lanes, by the numbers of as many pairs as
// there are lanes. Only the gradients of weights add up over pairs. They are a product of two matrices, whose operands lanes
// exchange through shared memory: the second layer's by tiles of TILE_ROWS outputs and four inputs a lane. A team of BLOCKS lanes
// holds all sums of the first layer's direction and distance. Each lane has four neurons, and each team adds up its own pairs. A
// lane keeps its sums in registers until the end.

const uint TILE_ROWS = WIDTH * BLOCKS / ACROSS;   // outputs of a lane's tile
const uint TEAMS = SUBGROUP / BLOCKS;
const uint PITCH = BLOCKS + 1u;                   // of a lane's row in shared memory: one more, so that banks differ

shared vec4 shared_neurons[SUBGROUP * PITCH]; // outputs of the first layer, then their gradients
shared vec4 shared_slopes[ACROSS * PITCH];    // gradients of the second layer, over the last one's weights
shared vec4 shared_ways[SUBGROUP];

float slopes[WIDTH];        // sums of the second layer; then the derivative of the loss by them
vec4 by_second[TILE_ROWS];  // sums over pairs: this lane's tile
vec4 by_pair[4];            // the same of direction and distance over this team's pairs: four neurons, by input

#define LAYER_SUMS                                                                                             \
    EACH(j, TILE_ROWS) by_second[j] = vec4(0.0);                                                               \
    EACH(k, 4u) by_pair[k] = vec4(0.0);
#define BACK(slope) back(slope);
#define WRITE_SUMS write_sums();

void layers_begin() {}

float added(vec4 w, vec4 x, float sum) { return fma(w.x, x.x, fma(w.y, x.y, fma(w.z, x.z, fma(w.w, x.w, sum)))); }

// Sums over lanes that are `reach` apart, and its multiples by powers of two.
vec4 sum_from(uint reach, vec4 v) {
    [[unroll]] for (; reach < SUBGROUP; reach *= 2u) {
        v += vec4(subgroupShuffleXor(v.x, reach), subgroupShuffleXor(v.y, reach), subgroupShuffleXor(v.z, reach),
                  subgroupShuffleXor(v.w, reach));
    }
    return v;
}

// The jittered pair and the pair itself, whose state the backward pass uses, share loads of weights.
float evaluate(FieldStep field, vec3 moved_point, vec3 point, uint light, vec3 place) {
    vec4 moved_way = vec4(0.0);
    float moved_sums[WIDTH], moved_logit = 0.0;
    if (REGULARIZED) {
        moved_way = field_way(field, moved_point, field_inside(field, place + jitter_of(field, LIGHTS, light)));
        EACH(n, WIDTH) moved_sums[n] = 0.0;
    }
    way = field_way(field, point, field_inside(field, place));
    EACH(n, WIDTH) slopes[n] = 0.0;
    logit = 0.0;
    alive = 0u;
    // A loop, because instructions do not fit in caches otherwise.
    [[dont_unroll]] for (uint b = 0u; b < BLOCKS; b++) {
        vec4 hidden, moved;
        EACH(j, 4u) {
            uint k = 4u * b + j;
            vec4 w = pair_from(k);
            hidden[j] = first_layer(w, way, row_of(k, false));
            if (REGULARIZED) moved[j] = first_layer(w, moved_way, row_of(k, true));
            alive |= uint(hidden[j] > 0.0) << k;
        }
        shared_neurons[gl_SubgroupInvocationID * PITCH + b] = hidden;
        EACH(n, WIDTH) {
            vec4 w = second_from(n * BLOCKS + b);
            slopes[n] = added(w, hidden, slopes[n]);
            if (REGULARIZED) moved_sums[n] = added(w, moved, moved_sums[n]);
        }
    }
    EACH(b, BLOCKS) {
        vec4 w = last_from(b);
        EACH(j, 4u) {
            logit = fma(w[j], rectified(slopes[4u * b + j]), logit);
            if (REGULARIZED) moved_logit = fma(w[j], rectified(moved_sums[4u * b + j]), moved_logit);
        }
    }
    return moved_logit;
}

// Adds a lane's pair, whose slopes are in a row of shared_slopes, to the tile of the second layer.
void add_second(uint lane, uint row) {
    uint block = column() % BLOCKS, first = column() / BLOCKS * TILE_ROWS;
    vec4 hidden = shared_neurons[lane * PITCH + block];
    EACH(q, TILE_ROWS / 4u) {
        vec4 g = shared_slopes[row * PITCH + first / 4u + q];
        EACH(j, 4u) by_second[4u * q + j] = fma(vec4(g[j]), hidden, by_second[4u * q + j]);
    }
}

// The same for the first layer's direction and distance.
void add_pair(uint lane) {
    vec4 g = shared_neurons[lane * PITCH + gl_SubgroupInvocationID % BLOCKS], w = shared_ways[lane];
    EACH(k, 4u) by_pair[k] = fma(g, vec4(w[k]), by_pair[k]);
}

// Calls f(pair) for each pair of a team, which has every `teams`-th: TOGETHER in a round, enough loads to hide their latency.
const uint TOGETHER = 4u;
#define EACH_PAIR(f, count, team, teams)                                                                       \
    [[dont_unroll]] for (uint round_ = 0u; round_ < count; round_ += TOGETHER * teams) {                       \
        EACH(j_, TOGETHER) f(round_ + j_ * teams + team);                                                      \
    }

// Backward pass of a pair, from the derivative of the loss by its logit.
void back(float slope) {
    uint lane = gl_SubgroupInvocationID, side = lane / ACROSS;
    EACH(n, WIDTH) slopes[n] = slopes[n] > 0.0 ? slope : 0.0;
    turn = vec4(0.0);
    [[dont_unroll]] for (uint writer = 0u; writer < SIDES; writer++) {
        if (side == writer) {
            EACH(b, BLOCKS) {
                uint n = 4u * b;
                shared_slopes[column() * PITCH + b] = vec4(slopes[n], slopes[n + 1u], slopes[n + 2u], slopes[n + 3u]);
            }
        }
        exchange();
#define ADD_SECOND(i_) add_second(writer * ACROSS + i_, i_)
        EACH_PAIR(ADD_SECOND, ACROSS, side, SIDES)
        exchange();
    }
    EACH(b, BLOCKS) {
        vec4 w = last_from(b);
        EACH(j, 4u) slopes[4u * b + j] *= w[j];
    }
    [[dont_unroll]] for (uint b = 0u; b < BLOCKS; b++) {
        vec4 g = vec4(0.0);
        EACH(n, WIDTH) g = fma(second_from(n * BLOCKS + b), vec4(slopes[n]), g);
        EACH(j, 4u) {
            uint k = 4u * b + j;
            g[j] = (alive >> k & 1u) != 0u ? g[j] : 0.0;
            turn = fma(vec4(g[j]), pair_from(k), turn);
        }
        shared_neurons[lane * PITCH + b] = g;
    }
    // Constants index sums of the pixel, so that they stay in registers.
    EACH(b, BLOCKS) by_row[b] += shared_neurons[lane * PITCH + b];
    shared_ways[lane] = way;
    exchange();
    EACH_PAIR(add_pair, SUBGROUP, lane / BLOCKS, TEAMS)
    exchange();
}

// The last layer's gradients are sums over the first layer's outputs, too, by the second layer's weights.
void write_sums() {
    uint to = gl_WorkGroupID.x * SUMS, block = column() % BLOCKS, part = column() / BLOCKS;
    bool writes = gl_SubgroupInvocationID < ACROSS;
    EACH(j, TILE_ROWS) {
        uint n = part * TILE_ROWS + j;
        vec4 sum = sum_from(ACROSS, by_second[j]);
        float by_last = dot(sum, second_from(n * BLOCKS + block));
        [[unroll]] for (uint reach = 1u; reach < BLOCKS; reach *= 2u) by_last += subgroupShuffleXor(by_last, reach);
        sum *= last_from(n / 4u)[j % 4u];
        if (writes) {
            EACH(k, 4u) sums_of[to + n * WIDTH + 4u * block + k] = sum[k];
            if (block == 0u) sums_of[to + WIDTH * (WIDTH + 4u) + n] = by_last;
        }
    }
    EACH(h, 4u) {
        vec4 sum = sum_from(BLOCKS, by_pair[h]);
        if (gl_SubgroupInvocationID < BLOCKS) {
            uint at = to + WIDTH * (WIDTH + h) + 4u * gl_SubgroupInvocationID;
            EACH(k, 4u) sums_of[at + k] = sum[k];
        }
    }
}

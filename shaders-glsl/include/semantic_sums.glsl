// Shared part of semantic_samples and correspondence_bwd: gradients of a batch by features, and sums for the decoder's.
//
// With v = A f', n = |v|, the loss's derivative is
//     by v:  s t + sum_c e_c T_c + k v
//     by f:  s (W^T t) + sum_c e_c (T W)_c + k (A^T A f')
//     by A:  sum s t f'^T  +  T^T (sum e f'^T)  +  A (sum k f' f'^T)
// A workgroup, which is one subgroup, accumulates the two sums in parentheses. Needs the buffer `partials`, rows by
// workgroup.
#include "semantic_batch.glsl"

float a[TILES * SPREAD];  // the gradient by features, before the division by their divisor
float row_sums[ROWS * HELD];  // the sums, columns over lanes; indexed by a variable
float ending[ROWS];       // their last column: sums of this lane's own items
// The same in shared memory on wide subgroups: summed over the sides, or over all lanes. So many rows take 16 KiB; more of them
// stay private.
const bool SHARES = SUBGROUP >= 16u && ROWS <= 128u;
shared float shared_sums[SHARES ? ROWS * FEATURES : 1u], shared_ending[SHARES ? ROWS : 1u];
float weights[TILES];     // of items, for absorb()
uint label[TILES];        // for descend(): the items' classes, and
float own[TILES];         // k before the cross-entropy

void clear_sums() {
    for (uint i = 0u; i < ROWS; i++) {
        if (SHARES) {
            if (gl_SubgroupInvocationID < ACROSS) {
                EACH_HELD(h) shared_sums[(i * HELD + h) * ACROSS + gl_SubgroupInvocationID] = 0.0;
            }
            if (gl_SubgroupInvocationID == 0u) shared_ending[i] = 0.0;
        } else {
            EACH_HELD(h) row_sums[i * HELD + h] = 0.0;
            ending[i] = 0.0;
        }
    }
}

// Adds to row i of the sums. A lane of the first side adds for the others, so that no two lanes write one word.
void add_row(uint i, float sum[HELD]) {
    EACH_HELD(h) {
        if (SHARES) {
            float whole = sum[h];
            if (SIDES > 1u) whole += subgroupShuffleXor(whole, ACROSS);
            if (gl_SubgroupInvocationID < ACROSS) {
                shared_sums[(i * HELD + h) * ACROSS + gl_SubgroupInvocationID] += whole;
            }
        } else {
            row_sums[i * HELD + h] += sum[h];
        }
    }
}

// Adds to the last column of row i.
void add_ending(uint i, float end) {
    if (SHARES) {
        float whole = subgroupAdd(end);
        if (gl_SubgroupInvocationID == 0u) shared_ending[i] += whole;
    } else {
        ending[i] += end;
    }
}

// Adds weight times f' of each item to row i of the sums, and weight times the current row of `matrices` to its gradient.
void absorb(uint i) {
    float sum[HELD], end = 0.0;
    EACH_HELD(h) sum[h] = 0.0;
    EACH_TILE(t) {
        EACH_ITEM(n) {
            float s = subgroupShuffle(weights[t], lane_of(n));
            uint at = t * SPREAD + n * HELD;
            EACH_HELD(h) {
                a[at + h] = fma(s, row[h], a[at + h]);
                sum[h] = fma(s, f[at + h], sum[h]);
            }
        }
        end = fma(weights[t], bias[t], end);
    }
    add_row(i, sum);
    add_ending(i, end);
}

// Adds the gradient of the cross-entropy to `label`, times `weight`, and of k, which is `own` plus the share from the
// cross-entropy, to `a` and the sums. Returns the lane's cross-entropies.
float descend(float weight) {
    float scale[TILES], chosen[TILES];
    Softmax s[TILES];
    EACH_TILE(t) {
        scale[t] = inverse[t] * params.step.inverse_temperature;
        s[t] = Softmax(-1e30, 0.0);
        chosen[t] = 0.0;
    }
    for (uint c = 0u; c < CLASSES; c++) {
        fetch_row(AUGMENTED + c);
        EACH_TILE(t) {
            float logit = product(t) * scale[t];
            chosen[t] = c == label[t] ? logit : chosen[t];
            add_logit(s[t], logit);
        }
    }
    for (uint c = 0u; c < CLASSES; c++) {
        fetch_row(AUGMENTED + c);
        EACH_TILE(t) {
            float logit = product(t) * scale[t];
            float g = weight * (exp(logit - s[t].top) / s[t].total - float(c == label[t]));
            g = live[t] && label[t] < CLASSES ? g : 0.0;
            own[t] = fma(-g * logit, inverse[t] * inverse[t], own[t]);
            weights[t] = g * scale[t];
        }
        absorb(AUGMENTED + c);
    }
    // From here on `u` is k f': factors of single items would take a scalar register each.
    EACH_TILE(t) {
        float k = live[t] ? own[t] : 0.0;
        weights[t] = k * bias[t];
        EACH_ITEM(n) {
            float factor = subgroupShuffle(k, lane_of(n));
            uint at = t * SPREAD + n * HELD;
            EACH_HELD(h) {
                a[at + h] = fma(factor, u[at + h], a[at + h]);
                u[at + h] = factor * f[at + h];
            }
        }
    }
    for (uint j = 0u; j < ACROSS; j++) {
        EACH_HELD(g) {
            float sum[HELD];
            EACH_HELD(h) sum[h] = 0.0;
            EACH_TILE(t) EACH_ITEM(n) {
                uint at = t * SPREAD + n * HELD;
                float s = subgroupShuffle(u[at + g], lane_of(j));
                EACH_HELD(h) sum[h] = fma(s, f[at + h], sum[h]);
            }
            add_row(g * ACROSS + j, sum);
        }
    }
    EACH_HELD(h) row[h] = 0.0;
    absorb(FEATURES);
    float entropy = 0.0;
    EACH_TILE(t) entropy += live[t] && label[t] < CLASSES ? log(s[t].total) + s[t].top - chosen[t] : 0.0;
    return entropy;
}

// Writes the sums of the workgroup. The last column of the square part is its last row.
void write_sums() {
    for (uint i = 0u; i < ROWS; i++) {
        uint to = (gl_WorkGroupID.x * ROWS + i) * PITCH;
        EACH_HELD(h) {
            float sum = 0.0;
            if (SHARES) {
                if (gl_SubgroupInvocationID < ACROSS) sum = shared_sums[(i * HELD + h) * ACROSS + gl_SubgroupInvocationID];
            } else {
                sum = row_sums[i * HELD + h];
                for (uint reach = ACROSS; reach < SUBGROUP; reach *= 2u) sum += subgroupShuffleXor(sum, reach);
            }
            if (gl_SubgroupInvocationID < ACROSS) {
                partials[to + h * ACROSS + gl_SubgroupInvocationID] = sum;
                uint mirror = (gl_WorkGroupID.x * ROWS + h * ACROSS + gl_SubgroupInvocationID) * PITCH + FEATURES;
                if (i == FEATURES) partials[mirror] = sum;
            }
        }
        float end = SHARES ? 0.0 : subgroupAdd(ending[i]);
        if (SHARES && gl_SubgroupInvocationID == 0u) end = shared_ending[i];
        if (i >= FEATURES && subgroupElect()) partials[to + FEATURES] = end;
        if (gl_SubgroupInvocationID < PITCH - AUGMENTED) partials[to + AUGMENTED + gl_SubgroupInvocationID] = 0.0;
    }
}

// Products of a layer's matrix with eight items at a time (or four, see ITEM_COUNT), neurons spread over the lanes.
//
// Lane c of a side holds neurons c HELD, c HELD + 1 and so on, of all items. A column of the matrix multiplies an item's
// number that its lane broadcasts. Matrices lie in arrays of an invocation, which CPUs read as cheaply as constants,
// unlike buffers or shared memory. Compilers stop unrolling long loops, so loops over items are written out. Needs
// SUBGROUP; call from uniform control flow.

const uint WIDTH = 32u;
#ifndef ITEM_COUNT
#define ITEM_COUNT 8
#endif
const uint ITEMS = ITEM_COUNT;
const uint ACROSS = SUBGROUP < WIDTH ? SUBGROUP : WIDTH;
const uint HELD = WIDTH / ACROSS;
const uint SIDES = SUBGROUP / ACROSS;

// This lane among those of its side, and its first neuron.
uint column() { return gl_SubgroupInvocationID % ACROSS; }
uint neuron(uint h) { return column() * HELD + h; }

// What lane c of this side has. (On lavapipe a broadcast takes several times as long as a shuffle.)
float from_lane(float x, uint c) {
    return subgroupShuffle(x, SIDES > 1u ? gl_SubgroupInvocationID / ACROSS * ACROSS + c : c);
}

// Held where products stay numbers, whatever the weights have become.
float rectified(float x) { return min(max(x, 0.0), 1e18); }

#define EACH_HELD(h) [[unroll]] for (uint h = 0u; h < HELD; h++)
#if ITEM_COUNT == 8
#define EACH_ITEM(f) f(0u); f(1u); f(2u); f(3u); f(4u); f(5u); f(6u); f(7u);
#else
#define EACH_ITEM(f) f(0u); f(1u); f(2u); f(3u);
#endif

// Fills an array by `at(k, h)`: on processors by a loop, elsewhere written out, so that it lies in registers.
#define FILL_COLUMNS(array_, count_, at_)                                                                      \
    if (SUBGROUP <= 8u) {                                                                                      \
        [[dont_unroll]] for (uint i_ = 0u; i_ < (count_) * HELD; i_++) array_[i_] = at_(i_ / HELD, i_ % HELD); \
    } else {                                                                                                   \
        [[unroll]] for (uint i_ = 0u; i_ < (count_) * HELD; i_++) array_[i_] = at_(i_ / HELD, i_ % HELD);      \
    }

// Sums over the lanes of a side of as many values as there are items: afterwards lane c has the sum of value c % ITEMS.
#define ITEM_SUMS_AT(values_, reach_)                                                                          \
    {                                                                                                          \
        bool upper_ = (gl_SubgroupInvocationID & reach_) != 0u;                                                \
        [[unroll]] for (uint j_ = 0u; j_ < reach_; ++j_) {                                                     \
            float sent_ = upper_ ? values_[j_] : values_[j_ + reach_];                                        \
            float own_ = upper_ ? values_[j_ + reach_] : values_[j_];                                         \
            values_[j_] = own_ + subgroupShuffleXor(sent_, reach_);                                          \
        }                                                                                                      \
    }
#if ITEM_COUNT == 8
#define ITEM_SUMS_FIRST(values_) ITEM_SUMS_AT(values_, 4u)
#else
#define ITEM_SUMS_FIRST(values_)
#endif
#define ITEM_SUMS(values_)                                                                                     \
    ITEM_SUMS_FIRST(values_)                                                                                   \
    ITEM_SUMS_AT(values_, 2u)                                                                                  \
    ITEM_SUMS_AT(values_, 1u)                                                                                  \
    if (ITEMS < 8u) values_[0] += subgroupShuffleXor(values_[0], 4u);                                          \
    if (ACROSS > 8u) values_[0] += subgroupShuffleXor(values_[0], 8u);                                         \
    if (ACROSS > 16u) values_[0] += subgroupShuffleXor(values_[0], 16u);

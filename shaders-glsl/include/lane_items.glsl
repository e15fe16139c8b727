// Items of 32 features, one a lane, with their features spread over the lanes.
//
// Lane c of ACROSS holds features c, ACROSS + c and so on of all items of its side. So a row of 32 numbers multiplies as
// many items as there are lanes without shuffles, and the lanes' partial results of an item are summed by halving.
//
// `x[n * HELD + h]` is feature h * ACROSS + c of the item that belongs to lane n of the side. Needs SUBGROUP.

const uint ACROSS = SUBGROUP < FEATURES ? SUBGROUP : FEATURES;
const uint HELD = FEATURES / ACROSS;
const uint SPREAD = ACROSS * HELD;  // features that a lane has of a tile: 32
const uint SIDES = SUBGROUP / ACROSS;

uint column() { return gl_SubgroupInvocationID % ACROSS; }

// The lane that item n of this lane's side belongs to.
uint lane_of(uint n) { return SIDES > 1u ? gl_SubgroupInvocationID / ACROSS * ACROSS + n : n; }

// Of loops that are left to be loops. Compilers take long over unrolled loads and stores, on processors foremost.
#define SHORT [[dont_unroll]]

#define EACH_ITEM(n) [[unroll]] for (uint n = 0u; n < ACROSS; n++)
#define EACH_HELD(h) [[unroll]] for (uint h = 0u; h < HELD; h++)

// Joins what all lanes of a side have of each item; afterwards values[0] is what belongs to this lane's own item. Half of
// the values change hands at each distance.
#define JOIN_SUM(a, b) ((a) + (b))
#define JOIN_MAX(a, b) max(a, b)
#define JOIN_LANES(T, values, JOIN)                                                                            \
    if (ACROSS > 16u) JOIN_AT(16u, T, values, JOIN)                                                            \
    if (ACROSS > 8u) JOIN_AT(8u, T, values, JOIN)                                                              \
    JOIN_AT(4u, T, values, JOIN)                                                                               \
    JOIN_AT(2u, T, values, JOIN)                                                                               \
    JOIN_AT(1u, T, values, JOIN)

// One distance. Written out because not every driver unrolls a loop whose counter is halved.
#define JOIN_AT(reach_, T, values, JOIN)                                                                       \
    {                                                                                                          \
        bool upper_ = (gl_SubgroupInvocationID & reach_) != 0u;                                                \
        [[unroll]] for (uint j_ = 0u; j_ < reach_; ++j_) {                                                     \
            T sent_ = upper_ ? values[j_] : values[j_ + reach_];                                              \
            T own_ = upper_ ? values[j_ + reach_] : values[j_];                                               \
            values[j_] = JOIN(own_, subgroupShuffleXor(sent_, reach_));                                      \
        }                                                                                                      \
    }

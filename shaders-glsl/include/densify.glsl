// Shared definitions of the densification kernels: settings, decisions, the plan, and the list of moves.

// Settings, in a uniform.
struct Densify {
    float grad_threshold; // mean length of the screen-space gradient from which a Gaussian is refined
    float normal_threshold; // mean length of the gradient by its raw normal from which it is refined as well; 0 for none
    float split_size;     // largest axis, world units: above it a Gaussian is split, else cloned
    float prune_opacity;  // fainter ones go
    float prune_weight;   // with less accumulated blending weight they go
    float prune_size;     // with a larger axis, world units, they go
    uint cap;             // most Gaussians afterwards
    uint seed;            // of the random numbers; another one each time
};

// Verdict on a Gaussian: its kind in the low bits, and for the refined ones the strength of the gradient above them.
const uint KEEP = 0u;
const uint PRUNE = 1u;
const uint CLONE = 2u;
const uint SPLIT = 3u;
const uint VERDICT_BITS = 2u;
const uint VERDICT_MASK = 3u;

uint verdict_kind(uint verdict) { return verdict & VERDICT_MASK; }
bool refined(uint verdict) { return verdict_kind(verdict) >= CLONE; }
uint verdict_strength(uint verdict) { return verdict >> VERDICT_BITS; }

// Strength of a gradient, at least 1: eight steps an octave, in its order.
const uint STRENGTHS = 2048u;
uint strength_of(float gradient) { return 1u + (floatBitsToUint(max(gradient, 0.0)) >> 20u); }

// Counters, zero at first: these, then one for each strength.
const uint COUNT_PRUNED = 0u;
const uint COUNT_INVALID = 1u;
const uint COUNT_REFINED = 2u;
const uint COUNT_SPARED = 3u; // the largest complement of the index of a pruned one whose numbers are finite
const uint COUNT_WEIGHTLESS = 4u;
const uint COUNT_STRENGTHS = 5u;

struct DensifyPlan {
    uint before;  // Gaussians before
    uint after;   // and afterwards
    uint pruned;
    uint added;   // new Gaussians: one for each accepted refinement
    uint cutoff;  // stronger ones are all accepted, weaker ones refused,
    uint strong;  // this many are stronger,
    uint ties;    // and this many of exactly that strength are accepted, by ascending index
};

// One Gaussian that is copied: to `home`, which may be where it is, and its child to `child`.
const uint NOWHERE = 0xffffffffu;
struct Move {
    uint from;
    uint home;
    uint child; // or NOWHERE
    uint kind;  // CLONE, SPLIT, KEEP for a plain move, PRUNE for an entry that is not used
};

// What happened, for the host.
struct DensifyStats {
    uint before;
    uint after;
    uint pruned;
    uint invalid;    // of the pruned ones, those with a number that is not finite,
    uint weightless; // and those that are opaque enough, but below the minimum blending weight
    uint cloned;
    uint split;
    uint refused; // candidates that did not fit under the cap
};

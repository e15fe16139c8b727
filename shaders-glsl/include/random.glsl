// Counter-based random numbers: a pure function of the seed and the counters.

// One round of PCG's 32-bit generator with its output permutation (O'Neill 2014; as a hash, Jarzynski and Olano 2020).
uint pcg(uint x) {
    uint state = x * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

uint random_bits(uint seed, uint a, uint b) { return pcg(pcg(pcg(seed) + a) + b); }

// In (0, 1): the middle of one of 2^23 equal intervals, so neither end is ever reached.
float uniform_from(uint bits) { return (float(bits >> 9u) + 0.5) * (1.0 / 8388608.0); }

// Two independent standard normal numbers (Box and Muller 1958).
vec2 normal_from(uint bits_a, uint bits_b) {
    float radius = sqrt(-2.0 * log(uniform_from(bits_a)));
    float angle = 6.28318530718 * uniform_from(bits_b);
    return radius * vec2(cos(angle), sin(angle));
}

// Coverage threshold: pixels below it have no surface. They are not shaded, and losses ignore them.
const float LEAST_COVERAGE = 1e-3;

bool is_covered(float coverage) { return coverage >= LEAST_COVERAGE; }

float inverse_coverage(float coverage) { return is_covered(coverage) ? 1.0 / coverage : 0.0; }

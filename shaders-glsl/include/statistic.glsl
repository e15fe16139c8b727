// Losses whose gradients enter the densification statistic. Needs CHANNELS; the first three channels are colors.
//
// The statistic needs two moments of its own where it is not that of all gradients: h p and h dy (blend_bwd.glsl).

const uint STATISTIC_TOTAL = 0u;       // every loss that reaches the footprint; no moments of its own
const uint STATISTIC_PHOTOMETRIC = 1u; // losses of color
const uint STATISTIC_GEOMETRIC = 2u;   // losses of normals, depth and transmittance
layout(constant_id = 25) const uint STATISTIC = 0;

const uint STATISTIC_FLOATS = STATISTIC == STATISTIC_TOTAL ? 0u : 2u;

bool in_statistic(uint channel) { return STATISTIC == STATISTIC_PHOTOMETRIC ? channel < 3u : channel >= 3u; }

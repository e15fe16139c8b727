// Gradients of a Gaussian's place, shape and opacity from other views of a step, side by side.

const uint EXTRA_WIDTH = 11u; // mean (3), log scale (3), rotation (4), opacity logit

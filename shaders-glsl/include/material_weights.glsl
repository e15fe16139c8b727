// Weights of the material losses in a step; the host writes them each step.
struct MaterialWeights {
    float albedo_msg;     // of the gradients of albedo at several scales, against the prior's
    float roughness_msg;  // likewise of roughness
    float albedo_edge;    // of the smoothness of albedo where the photograph is smooth
    float roughness_edge; // likewise of roughness
    float cross_view;     // of a region's mean albedo in several views, each pseudo-view
    float relight;        // of albedo against estimates under other light, all estimates together
    float own_prior;      // of albedo in the region against the view's own prior
};

// Losses of materials in a step, unweighted and weighted. Absent terms are 0.
struct MaterialStats {
    float total;          // of the following, weighted
    float albedo_msg;     // mean over the levels
    float roughness_msg;
    float albedo_edge;    // mean over pixels and channels
    float roughness_edge; // mean over pixels
    float cross_view;     // distances of mean albedo, summed over the pseudo-views
    float relight;        // squared differences and gradients, mean over the estimates
    float own_prior;      // squared differences and gradients against the view's own prior
    float saturated;      // share of the view's pixels of which a channel is cut off at white
    uint cross_pairs;     // pseudo-views whose region, and the training view's, were large enough
    uint relight_count;   // estimates of which something counted
    uint own_count;       // 1 if something of the own prior counted
};

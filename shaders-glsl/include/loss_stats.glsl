// Losses of a step: means before their weights, and the weighted total that was minimized.
struct LossStats {
    float total;
    float l1;
    float ssim;
    float normal;
    float normal_smooth;
    float depth_smooth;
    float depth_variance;
    float depth;                  // relative difference from prior depths, times their confidence
    float semantic;               // 1 - cos to the semantic targets
    float semantic_class;         // cross-entropy of their classes
    float correspondence;         // distance of a region's mean features, mean over the pseudo-views
    float correspondence_class;   // cross-entropy of its pixels to its class, likewise
    uint semantic_excluded;       // samples that did not count
    uint correspondence_pairs;    // pseudo-views that did
};

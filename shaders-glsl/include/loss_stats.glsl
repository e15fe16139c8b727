// What a step's losses came to: means before their weights, and the weighted total that was minimized.
struct LossStats {
    float total;
    float l1;
    float ssim;
    float normal;
    float normal_smooth;
    float depth_smooth;
    float depth_variance;
};

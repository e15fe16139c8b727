// A region in a view, and the gradient of its pixels.
struct CrossRegion {
    vec3 mean;   // of albedo in sRGB
    float count; // pixels
    vec3 pull;   // gradient of each pixel of the region
    float apart; // from the training view's mean; 0 where one of them is too small, and in the training view
};

// Fewer are no evidence.
const float LEAST_PIXELS = 16.0;

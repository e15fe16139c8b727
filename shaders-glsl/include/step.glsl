// Per-step parameters in the uniform ring: the camera and the schedule.

struct Camera {
    vec4 world_to_camera[3]; // rows; OpenCV axes: x right, y down, z forward
    vec3 position;           // world
    float near;
    vec2 focal;              // pixels
    vec2 center;             // principal point, pixels, never assumed central
    uvec2 size;              // pixels
    uvec2 tiles;             // tiles across and down
    float radial;            // radial distortion that training learned; zero elsewhere
};

struct Step {
    Camera camera;
    vec3 background;         // display-referred
    uint step;               // counts from 1
    uint target_offset;      // first pixel of this view in the buffers of photographs and priors
    uint sh_degree;          // active degree, at most the stored one
    uint seed;               // of this step's random numbers
    // Adam: learning rates by group, and 1/(1-beta^t)
    float lr_means;
    float lr_scales;
    float lr_rotations;
    float lr_opacities;
    float lr_sh0;
    float lr_sh_rest;
    float lr_normals;
    float lr_decoder;        // of the semantic decoder
    float lr_semantics;
    float lr_share;          // factor of learning rates that are set separately
    float correction1;
    float correction2;
    // loss weights
    float weight_l1;
    float weight_dssim;
    float weight_normal;
    float weight_normal_smooth;
    float weight_depth_smooth;
    float weight_depth_variance;
    float weight_depth;          // of relative differences from prior depths
    float weight_semantic;       // of 1 - cos to the semantic targets
    float weight_semantic_class; // of the cross-entropy of their classes
    float weight_correspondence; // of a region's correspondence, all pseudo-views together
    float inverse_temperature;   // of the classes' softmax
    // semantic targets of this view: size of the map, its first sample in the buffer of all, samples that say something,
    // and samples that have a class; first word of the view's region mask
    uvec2 semantic_size;
    uint semantic_offset;
    uint semantic_valid;
    uint semantic_labeled;
    uint mask_offset;
    // densification statistics: 1 while they are gathered
    uint gather_statistics;
    // the region that this step is about, as region maps number it: 1 to 65535, 0 is none
    uint region;
    uint region_offset; // first pixel of this view in the buffer of region maps
    // learned cameras and colors: the view's place among them, and their learning rates
    uint view;
    float lr_turn;           // radians
    float lr_shift;          // lengths
    float lr_gain;           // of the logarithms of the colors' factors
    float lr_lens;           // of the logarithm of focal lengths, and of the principal point in focal lengths
    float lr_radial;         // of radial distortion
    // densification by Markov chain Monte Carlo: weights of the means over all Gaussians, and the strength of the noise
    float weight_opacity;
    float weight_scale;      // 1 / length
    float noise;             // 1 / length: standard deviation of a mean along an axis, by the square of its scale
};

// What changes from step to step and comes through the uniform ring: the camera and the schedule.

struct Camera {
    vec4 world_to_camera[3]; // rows; OpenCV axes: x right, y down, z forward
    vec3 position;           // world
    float near;
    vec2 focal;              // pixels
    vec2 center;             // principal point, pixels, never assumed central
    uvec2 size;              // pixels
    uvec2 tiles;             // tiles across and down
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
    float correction1;
    float correction2;
    // loss weights
    float weight_l1;
    float weight_dssim;
    float weight_normal;
    float weight_normal_smooth;
    float weight_depth_smooth;
    float weight_depth_variance;
    // densification statistics: 1 while they are gathered
    uint gather_statistics;
};

// What training learns of a view: corrections of its camera's pose, and factors on its colors; and of the lens that all
// views share: corrections of focal length and principal point, vignetting, and radial distortion.
//
// A camera's center moves by `shift`; then the camera turns about its center by a rotation vector (axis times radians). Both
// are in world axes, so the mean over all views is the motion of the whole scene, which no photograph shows.
// The lens is the record after those of the views.

const uint VIEW_VALUES = 9u; // turn, shift, logarithms of the factors on red, green and blue
const uint VIEW_TURN = 0u, VIEW_SHIFT = 3u, VIEW_GAIN = 6u;

// Values of the lens.
const uint LENS_FOCAL = 0u;      // logarithm of the factor on focal lengths
const uint LENS_CENTER = 1u;     // shift of the principal point, in focal lengths
const uint LENS_VIGNETTING = 3u; // logarithm of the factor on colors at the corners of the image
const uint LENS_INTRINSICS = 3u; // values of focal length and principal point
const uint LENS_RADIAL = 4u;     // radial distortion, as `Camera` has it
const uint LENS_VALUES = 5u;

struct LearnedView {
    float values[9];
    vec2 moments[9]; // of Adam
    uint steps;      // of Adam that this view has had
};

vec3 learned_vector(LearnedView view, uint first) {
    return vec3(view.values[first], view.values[first + 1u], view.values[first + 2u]);
}

// exp([turn]) v - v. By Rodrigues' formula, with series for short vectors.
vec3 turned_by(vec3 turn, vec3 v) {
    float square = dot(turn, turn), angle = sqrt(square), half_angle = 0.5 * angle;
    float along = square < 1e-6 ? 1.0 - square / 6.0 : sin(angle) / angle;
    float ratio = square < 1e-6 ? 1.0 - square / 24.0 : sin(half_angle) / half_angle;
    vec3 once = cross(turn, v);
    return along * once + 0.5 * ratio * ratio * cross(turn, once);
}

// Square of the distance of a pixel from the center of the image, relative to that of the corners.
float corner_share(uvec2 size, uint pixel) {
    vec2 from_center = vec2(pixel % size.x, pixel / size.x) + 0.5 - 0.5 * vec2(size);
    return 4.0 * dot(from_center, from_center) / dot(vec2(size), vec2(size));
}

// One Gaussian seen by one camera: the projected record, its footprint, and the tiles that it touches.
//
// The footprint is stored as a triangular factor of the inverse covariance, scaled so that
//   alpha = opacity * exp2(-(p*p + q*q)),  p = factor.x*dx + factor.y*dy,  q = factor.z*dy.
// The factored form does not cancel for highly anisotropic Gaussians, where the quadratic form loses several digits.

#include "finite.glsl"

// What may be traded for speed (passes/src/accuracy.rs); the defaults are those of 3D Gaussian splatting.
layout(constant_id = 20) const float ALPHA_MIN = 1.0 / 255.0;
layout(constant_id = 21) const float TRANSMITTANCE_MIN = 1e-4;
layout(constant_id = 22) const bool KEEP_LAST = false; // whether the splat that would fill a pixel is blended

const float ALPHA_MAX = 0.99;
const float LOG_SCALE_MIN = -16.0;
const float LOG_SCALE_MAX = 8.0;    // beyond it a splat is flat over any image, and squares would overflow
const float DEPTH_MAX = 1e18;       // of blended depth: its square is blended, too, and must stay finite
const float FACTOR_SCALE = 0.84932180028801904; // sqrt(log2(e)/2): exp(-x/2) = exp2(-FACTOR_SCALE² x)

struct Splat {
    vec2 mean;     // pixels
    vec3 factor;   // u11, u12, u22
    float opacity;
};

// Quaternion (w,x,y,z) to unit length; zero or not finite becomes the identity. Scaled first so that huge and tiny
// ones neither overflow nor vanish.
vec4 unit_quaternion(vec4 q, out float inverse_norm) {
    // Compared as integers: bits of non-finite numbers are larger. max() of floats may drop a NaN.
    uvec4 bits = floatBitsToUint(q) & 0x7fffffffu;
    uint top = max(max(bits.x, bits.y), max(bits.z, bits.w));
    float m = uintBitsToFloat(top);
    inverse_norm = 0.0;
    if (top >= 0x7f800000u || !(m > 0.0)) return vec4(1.0, 0.0, 0.0, 0.0);
    q /= m;
    float n = inversesqrt(dot(q, q));
    inverse_norm = n / m;
    return q * n;
}

mat3 quaternion_matrix(vec4 q) {
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

mat3 camera_rotation(Camera c) {
    return transpose(mat3(c.world_to_camera[0].xyz, c.world_to_camera[1].xyz, c.world_to_camera[2].xyz));
}

vec3 to_camera(Camera c, vec3 p) {
    return vec3(dot(c.world_to_camera[0], vec4(p, 1.0)), dot(c.world_to_camera[1], vec4(p, 1.0)),
                dot(c.world_to_camera[2], vec4(p, 1.0)));
}

// Inclusive range of pixels, empty if low > high.
struct PixelBox {
    ivec2 low;
    ivec2 high;
};

// The largest exponent at which alpha still reaches ALPHA_MIN, widened by a rounding error so that
// blending never finds a pixel that no tile holds.
float exponent_limit(Splat s) {
    precise float limit = log2(1.0 / ALPHA_MIN * s.opacity) * 1.00001 + 1e-5;
    return limit;
}

// Pixels whose centers lie in the box around the footprint, within the image.
PixelBox splat_box(Splat s, float limit, uvec2 size) {
    precise float reach = sqrt(max(limit, 0.0));
    precise float skew = s.factor.y / (s.factor.x * s.factor.z);
    precise vec2 half_size = reach * vec2(sqrt(skew * skew + 1.0 / (s.factor.x * s.factor.x)), 1.0 / s.factor.z);
    precise vec2 low = clamp(ceil(s.mean - half_size - 0.5), vec2(0.0), vec2(size));
    precise vec2 high = clamp(floor(s.mean + half_size - 0.5), vec2(-1.0), vec2(size) - 1.0);
    return PixelBox(ivec2(low), ivec2(high));
}

const PixelBox EMPTY_BOX = PixelBox(ivec2(1), ivec2(0));

bool box_is_empty(PixelBox b) { return b.low.x > b.high.x || b.low.y > b.high.y; }

// Pixels of row y whose centers lie in the footprint, unclipped; empty if x > y.
ivec2 splat_row(Splat s, float limit, int y) {
    precise float dy = float(y) + 0.5 - s.mean.y;
    precise float q = s.factor.z * dy;
    precise float rest = limit - q * q;
    if (rest < 0.0) return ivec2(1, 0);
    precise float middle = s.mean.x - 0.5 - s.factor.y * dy / s.factor.x;
    precise float half_width = sqrt(rest) / s.factor.x;
    // Held to the range of pixels that exist, so that the conversion is defined.
    return ivec2(clamp(ceil(middle - half_width), -1.0, 1e6), clamp(floor(middle + half_width), -2.0, 1e6));
}

// The row of pixels that holds the center, or one far outside of the image.
int splat_center_row(Splat s) { return int(floor(clamp(s.mean.y, -1e6, 1e6))); }

// Whether a pixel center of columns [x0, x1] and rows [y0, y1] lies in the footprint, trying the row nearest to the
// center first: interior tiles of a large splat answer at once.
bool splat_touches(Splat s, float limit, int x0, int x1, int y0, int y1) {
    int first = clamp(splat_center_row(s), y0, y1);
    ivec2 row = splat_row(s, limit, first);
    bool touched = max(row.x, x0) <= min(row.y, x1);
    for (int y = y0; y <= y1 && !touched; ++y) {
        row = splat_row(s, limit, y);
        touched = max(row.x, x0) <= min(row.y, x1);
    }
    return touched;
}

// Tiles [x, y] that one row of tiles can have, from the union of its pixel rows; empty if x > y. The ends are touched;
// tiles between them are for `splat_touches` (a thin slanted needle can step over one).
ivec2 splat_tile_span(Splat s, float limit, PixelBox box, int y0, int y1, int tile_width) {
    ivec2 span = ivec2(0x7fffffff, -1);
    for (int y = max(y0, box.low.y); y <= min(y1, box.high.y); ++y) {
        ivec2 row = splat_row(s, limit, y);
        row = ivec2(max(row.x, box.low.x), min(row.y, box.high.x));
        if (row.x <= row.y) span = ivec2(min(span.x, row.x), max(span.y, row.y));
    }
    return span.x > span.y ? ivec2(1, 0) : span / tile_width;
}
